"""The searchable database of runs, grasps, alarms, journal lines and files."""
