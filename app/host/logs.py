"""The function that sets up the service's logs: on the error output, and as JSON lines in files of the data folder.

Each target has a thread of its own, so that an unread error output or a slow disk cannot block the service. Every line
names its run and grasp, if there are any.
"""

import contextlib
import logging
import os
import queue
import threading
import time
from dataclasses import dataclass
from logging.handlers import RotatingFileHandler
from pathlib import Path

from pythonjsonlogger.json import JsonFormatter

from config.schema import LogFormat, LogSettings

MAX_QUEUED_LINES = 1000
FLUSH_TIMEOUT_S = 0.2
ERROR_OUTPUT = 2  # file descriptor
MAX_FILE_BYTES, MAX_FILES = 2_000_000, 5
LOG_FOLDER, LOG_FILE = "logs", "graspwatch.jsonl"


@dataclass(slots=True)
class LogContext:
    """The run and grasp under way, which every log line names."""

    run: str | None = None
    grasp: int | None = None


class QueuedLogHandler(logging.Handler):
    """A handler that writes in a thread. If a paused terminal or full pipe blocks the thread, it drops lines."""

    def __init__(self, target: logging.Handler, level: int, log_context: LogContext) -> None:
        super().__init__(level)
        self._target, self._log_context = target, log_context
        self._records: queue.Queue[logging.LogRecord] = queue.Queue(MAX_QUEUED_LINES)
        self._dropped = 0
        threading.Thread(target=self._write_loop, name="logs", daemon=True).start()

    def emit(self, record: logging.LogRecord) -> None:
        """Queue a line, or count it as dropped if the queue is full."""
        record.msg, record.args = record.getMessage(), None  # arguments may change before the thread formats them
        record.run, record.grasp = self._log_context.run, self._log_context.grasp
        try:
            self._records.put_nowait(record)
        except queue.Full:
            self._dropped += 1

    def close(self) -> None:
        """Wait for the last lines for at most FLUSH_TIMEOUT_S."""
        end_s = time.monotonic() + FLUSH_TIMEOUT_S
        while self._records.unfinished_tasks and time.monotonic() < end_s:
            time.sleep(0.01)
        super().close()

    def _write_loop(self) -> None:
        while True:
            record, dropped = self._records.get(), self._dropped
            self._target.handle(record)
            if dropped:
                self._dropped -= dropped
                self._target.handle(_make_warning(f"{dropped} lines before this one were dropped: nobody read them"))
            self._records.task_done()


class _ErrorOutput(logging.Handler):
    """The error output without a lock and without a buffer.

    At the end of the process Python waits for both, and a paused terminal or full pipe would hold them for ever.
    """

    def createLock(self) -> None:
        """Have no lock: one thread writes."""
        self.lock = None

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line; raise nothing if the error output is closed."""
        line = f"{self.format(record)}\n".encode(errors="backslashreplace")
        with contextlib.suppress(OSError):
            while line:
                line = line[os.write(ERROR_OUTPUT, line) :]


class _SilentRotatingFileHandler(RotatingFileHandler):
    """A file handler that silently loses lines on a full disk, for which there is an alarm."""

    def handleError(self, record: logging.LogRecord) -> None:
        """Ignore the error."""


def configure_logging(settings: LogSettings, data: Path, log_context: LogContext) -> None:
    """Set up logging for the whole process. Each line names the run and grasp in `log_context` at that time."""
    fields = ("levelname", "name", "message", "run", "grasp")
    as_json = JsonFormatter(fields, timestamp="at", rename_fields={"levelname": "level", "name": "logger"})
    as_text = logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s")
    output = _ErrorOutput()
    output.setFormatter(as_json if settings.format is LogFormat.JSON else as_text)
    handlers: list[logging.Handler] = [
        QueuedLogHandler(output, logging.getLevelName(settings.level.upper()), log_context)
    ]
    if settings.keep:
        folder = data / LOG_FOLDER
        folder.mkdir(mode=0o700, exist_ok=True)
        file = _SilentRotatingFileHandler(
            folder / LOG_FILE, maxBytes=MAX_FILE_BYTES, backupCount=MAX_FILES - 1, encoding="utf-8", delay=True
        )
        file.setFormatter(as_json)
        handlers.append(QueuedLogHandler(file, logging.INFO, log_context))
    logging.basicConfig(handlers=handlers, level=logging.WARNING, force=True)
    logging.getLogger("graspwatch").setLevel(logging.INFO)


def _make_warning(text: str) -> logging.LogRecord:
    record = logging.LogRecord("graspwatch", logging.WARNING, __file__, 0, text, None, None)
    record.run = record.grasp = None
    return record
