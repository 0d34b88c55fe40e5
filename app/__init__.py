"""The command line, the server and the supervision of the workers."""
