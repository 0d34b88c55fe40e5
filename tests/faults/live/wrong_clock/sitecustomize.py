"""Put into every process of a service under test by PYTHONPATH: a wall clock set by a file, hours off the true one."""

import datetime
import os
import time

_true_s = time.time
_true_datetime = datetime.datetime


def _off_s() -> float:
    with open(os.environ["WRONG_CLOCK"]) as file:
        return 3600.0 * float(file.read() or 0)


class WrongDatetime(_true_datetime):
    @classmethod
    def now(cls, tz=None):
        return _true_datetime.now(tz) + datetime.timedelta(seconds=_off_s())


time.time = lambda: _true_s() + _off_s()
time.time_ns = lambda: int(1e9 * time.time())
datetime.datetime = WrongDatetime
