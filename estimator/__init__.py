"""Estimation: turn sample blocks into tissue parameters, probabilities and force alarms."""
