"""What can be searched: runs, grasps, alarms, audit and files in a database."""
