"""Reports, learned libraries, studies, calibrations, and runs without a service."""
