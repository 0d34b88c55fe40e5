"""Messages and frames for viewers, live or from a recording."""
