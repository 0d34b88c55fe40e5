"""What this computer gives: clock, disk, logs, processes."""
