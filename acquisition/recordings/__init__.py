"""Recordings: the lab's LabVIEW files and our own MCAP files, played as a source like the board."""
