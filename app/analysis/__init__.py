"""What recordings, studies and calibrations say afterwards."""
