"""Recordings: the lab's LabVIEW files and Graspwatch's MCAP files, read as a sample source like the board."""
