"""The live service: tool service, workers, runs, arming, control and watchdog."""
