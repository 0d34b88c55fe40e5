"""From the board or a recording to calibrated, conditioned and segmented sample blocks."""
