"""Put into a service under test by PYTHONPATH: writes what its limiter is told, and what it enforces, to a file."""

import json
import os

if path := os.environ.get("LIMIT_LOG"):
    from acquisition.safety.force_limiter import ForceLimiter

    set_threshold, limit_command = ForceLimiter.set_threshold, ForceLimiter.limit_command

    def write(*entry):
        with open(path, "a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")

    def logged_set_threshold(self, threshold_n, tick):
        set_threshold(self, threshold_n, tick)
        write("threshold", threshold_n, tick)

    def logged_limit_command(self, samples, commands_v, wanted_v):
        result = limit_command(self, samples, commands_v, wanted_v)
        write("command", int(samples["tick"][0]), commands_v, wanted_v, self.limit_n)
        return result

    ForceLimiter.set_threshold, ForceLimiter.limit_command = logged_set_threshold, logged_limit_command
