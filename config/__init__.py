"""Configuration: schema, loader, errors, and the shipped tools, tissues and protocols."""
