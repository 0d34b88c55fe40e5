"""Other estimators for the same task, to measure ours against: the paper's own, an unscented and a particle filter."""
