"""What stops the motor."""
