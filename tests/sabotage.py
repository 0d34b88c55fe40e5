"""Ways to lose a worker: signals, some of which only a saboteur module inside the worker handles."""

import signal
from pathlib import Path

SABOTEUR = Path(__file__).parent / "faults/live/saboteur"
"""Folder for a service's PYTHONPATH."""
SIGNALS = {
    "kill -9": signal.SIGKILL,
    "hangs": signal.SIGRTMIN + 2,
    "exception": signal.SIGUSR1,
    "memory hog": signal.SIGUSR2,
    "fills its error output": signal.SIGRTMIN + 1,
}
