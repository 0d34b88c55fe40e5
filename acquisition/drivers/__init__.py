"""Sample sources and the output of motor commands."""
