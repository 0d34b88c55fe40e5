"""Conditioning of raw samples: tare, filter, units, grasp and contact."""
