"""What every stage is told: schema, loader, errors, and the shipped tools, tissues and protocols."""
