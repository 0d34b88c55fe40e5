"""Compute the probabilities of a learned library from a grasp's loading curve."""
