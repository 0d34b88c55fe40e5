"""Where raw samples come from, and where commands go to."""
