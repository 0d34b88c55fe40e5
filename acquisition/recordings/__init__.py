"""Recordings: Graspwatch's MCAP files, LabVIEW logs and other tables, read as a sample source like the board."""
