"""Other estimators for comparison with the bank: the paper's filter, an unscented filter and a particle filter."""
