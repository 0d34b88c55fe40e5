"""Reports of recordings: courses over time, verdicts, warnings, and statistics of the tissues."""
