"""What viewers receive, live or from a recording."""
