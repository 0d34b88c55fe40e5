"""Safety functions that limit or stop the motor."""
