"""Every message between processes, programs and files, defined once."""
