"""Services of the computer: clock, disk, logs, recordings bin and background processes."""
