"""A recording's report: what happened, what was found, and what a set of grasps says of the tissues."""
