"""Recording of runs: the recorder process, its files, and what becomes of one that was cut off."""
