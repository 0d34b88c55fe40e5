"""Ways in which a worker is lost: signals, some of which only a saboteur inside it understands."""

import signal
from pathlib import Path

SABOTEUR = Path(__file__).parent / "faults/live/saboteur"
"""To be put into PYTHONPATH of a service."""
SIGNALS = {
    "kill -9": signal.SIGKILL,
    "hangs": signal.SIGRTMIN + 2,
    "exception": signal.SIGUSR1,
    "memory hog": signal.SIGUSR2,
}
