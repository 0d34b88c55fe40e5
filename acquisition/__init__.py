"""Conversion of a board's or a recording's signals into calibrated, conditioned and segmented sample blocks."""
