"""What the service logs, written by a thread: an error output that nobody reads must hold nobody up."""

import logging
import queue
import sys
import threading
import time

MOST_LINES = 1000
LAST_WORDS_S = 0.2


class LogsAside(logging.Handler):
    """A paused terminal or a full pipe blocks whoever writes to it; here that is a thread, and lines are dropped."""

    def __init__(self) -> None:
        super().__init__()
        self.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
        self._lines: queue.Queue[str] = queue.Queue(MOST_LINES)
        self._dropped = 0
        threading.Thread(target=self._write, name="logs", daemon=True).start()

    def emit(self, record: logging.LogRecord) -> None:
        """Take a line, or count it where there are too many."""
        try:
            self._lines.put_nowait(self.format(record))
        except queue.Full:
            self._dropped += 1

    def close(self) -> None:
        """Wait for the last lines, but not for long."""
        end_s = time.monotonic() + LAST_WORDS_S
        while self._lines.unfinished_tasks and time.monotonic() < end_s:
            time.sleep(0.01)
        super().close()

    def _write(self) -> None:
        while True:
            line, dropped = self._lines.get(), self._dropped
            print(line, file=sys.stderr, flush=True)
            if dropped:
                self._dropped -= dropped
                print(f"{dropped} lines before this one were dropped: nobody read them", file=sys.stderr, flush=True)
            self._lines.task_done()


def log_aside() -> None:
    """From here on, for the whole process."""
    logging.basicConfig(handlers=[LogsAside()], level=logging.WARNING, force=True)
