"""Studies: measure the estimator's accuracy, speed and calibration, each as one command."""
