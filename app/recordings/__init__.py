"""How runs are written, found, repaired, replayed and exchanged."""
