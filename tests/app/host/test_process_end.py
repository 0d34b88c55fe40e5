import signal
import subprocess
import sys

import pytest

ENDED_WHILE_IT_FORKS = """
import os, signal, sys, time
from app.host.process_end import exit_on_signals

exit_on_signals()
os.register_at_fork(after_in_parent=lambda: signal.raise_signal(int(sys.argv[1])))
if os.fork() == 0:
    os._exit(0)
try:
    time.sleep(20)
    print("it went on")
finally:
    print("files are closed")
"""


@pytest.mark.parametrize(
    ("number", "code"),
    [(signal.SIGTERM, 128 + signal.SIGTERM), (signal.SIGHUP, 128 + signal.SIGHUP), (signal.SIGINT, -signal.SIGINT)],
)
def test_a_signal_ends_a_program_that_is_starting_a_process(number: signal.Signals, code: int) -> None:
    """Python discards what a handler raises in a callback around a fork; the program went on, and ignored the next."""
    program = [sys.executable, "-c", ENDED_WHILE_IT_FORKS, str(int(number))]
    done = subprocess.run(program, capture_output=True, text=True, timeout=60, restore_signals=True)
    assert (done.returncode, done.stdout) == (code, "files are closed\n")
