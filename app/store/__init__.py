"""The index: runs, grasps, alarms, audit and files in a database, from the same messages live and on a rebuild."""
