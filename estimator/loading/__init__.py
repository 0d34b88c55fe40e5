"""Probabilities of a learned library from a grasp's loading curve."""
