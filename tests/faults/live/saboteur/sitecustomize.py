"""Put into every process of a service under test by PYTHONPATH: signals on which its main thread fails from inside."""

import logging
import signal
import time


def fail(number, frame):
    raise RuntimeError("sabotage")


def hog(number, frame):
    kept = []
    while True:
        kept.append(bytearray(b"x") * (64 << 20))


def chatter(number, frame):
    for _ in range(1200):
        logging.getLogger("graspwatch").error("x" * 1000)


def compute(number, frame):
    end_s = time.monotonic() + 2.5
    while time.monotonic() < end_s:
        pass


signal.signal(signal.SIGUSR1, fail)
signal.signal(signal.SIGUSR2, hog)
signal.signal(signal.SIGRTMIN, lambda number, frame: time.sleep(0.6))
signal.signal(signal.SIGRTMIN + 1, chatter)
signal.signal(signal.SIGRTMIN + 2, lambda number, frame: time.sleep(3600.0))
signal.signal(signal.SIGRTMIN + 3, compute)
