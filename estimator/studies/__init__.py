"""Studies that measure the estimator's accuracy, speed and calibration, each behind one command."""
