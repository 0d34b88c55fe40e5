"""Checks and calibration of a tool on the bench."""
