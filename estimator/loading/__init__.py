"""Probabilities of a learned library's tissues, computed from a grasp's loading curve."""
