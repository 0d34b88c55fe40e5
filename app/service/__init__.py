"""What runs while the tool is live: workers, runs, arming, alarms of a silent worker."""
