"""Studies of the estimator: from the command line, and from the dashboard."""
