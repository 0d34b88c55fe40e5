"""Put into a service under test by PYTHONPATH: writes what its limiter is told, and what it enforces, to a file."""

import json
import os

if path := os.environ.get("LIMIT_LOG"):
    from acquisition.limiter import HoldBack

    allow, judge = HoldBack.allow, HoldBack.judge

    def write(*entry):
        with open(path, "a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")

    def logged_allow(self, threshold_n, tick):
        allow(self, threshold_n, tick)
        write("allow", threshold_n, tick)

    def logged_judge(self, samples, commands_v, wanted_v):
        result = judge(self, samples, commands_v, wanted_v)
        write("judge", int(samples["tick"][0]), commands_v, wanted_v, self.limit_n)
        return result

    HoldBack.allow, HoldBack.judge = logged_allow, logged_judge
