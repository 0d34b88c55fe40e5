"""Functions that end this process cleanly after a signal, and discard its output if the reader has closed it."""

import os
import signal
import sys
import threading
from types import FrameType
from typing import NoReturn

ENDING_SIGNALS = (signal.SIGTERM, signal.SIGHUP)
REPEAT_AFTER_S = 0.01  # by then Python has left the callback that discarded the exception


def exit_on_signals() -> None:
    """Let SIGTERM and SIGHUP raise SystemExit with 128 + number, so that files and processes end in order.

    An ignored signal stays ignored, as after nohup(1). Call in the main thread, before any process is started.
    """
    for number in ENDING_SIGNALS:
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _exit)
    sys.unraisablehook = _repeat_discarded_exit


def _exit(number: int, frame: FrameType | None) -> None:
    for each in ENDING_SIGNALS:  # a second signal must not interrupt the end
        signal.signal(each, signal.SIG_IGN)
    raise SystemExit(128 + number)


def _repeat_discarded_exit(unraisable: "sys.UnraisableHookArgs") -> None:
    """Raise an exit, or Ctrl+C, again if Python discarded it.

    A signal's handler runs between any two instructions of the main thread. In a callback whose exceptions Python
    discards, as around a fork or in `__del__`, the program would lose its end and go on.
    """
    error = unraisable.exc_value
    here = threading.current_thread() is threading.main_thread()
    if not (here and isinstance(error, SystemExit | KeyboardInterrupt)):
        sys.__unraisablehook__(unraisable)
        return

    def repeat(number: int, frame: FrameType | None) -> NoReturn:
        raise error

    signal.signal(signal.SIGALRM, repeat)
    signal.setitimer(signal.ITIMER_REAL, REPEAT_AFTER_S)


def discard_output() -> None:
    """Discard what is still to be printed, because nobody can receive it: Python would fail again as it ends."""
    if sys.stdout:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
