"""What raw samples mean: tare, filter, units, contact."""
