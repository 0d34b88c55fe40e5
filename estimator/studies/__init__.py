"""Studies: how right, how early and how honest the estimator is, as commands anyone can run."""
