"""What the service logs: to the error output, and as JSON lines to files in the data folder.

Each target has a thread of its own: an error output that nobody reads, or a slow disk, must hold nobody up. Every line
says which run and which grasp it belongs to, if there is one.
"""

import logging
import queue
import sys
import threading
import time
from dataclasses import dataclass
from logging.handlers import RotatingFileHandler
from pathlib import Path

from pythonjsonlogger.json import JsonFormatter

from config.schema import LogFormat, LogSettings

MAX_QUEUED_LINES = 1000
FLUSH_TIMEOUT_S = 0.2
MAX_FILE_BYTES, MAX_FILES = 2_000_000, 5
LOG_FOLDER, LOG_FILE = "logs", "graspwatch.jsonl"


@dataclass(slots=True)
class LogContext:
    """What is under way, for the lines that are logged meanwhile."""

    run: str | None = None
    grasp: int | None = None


class QueuedLogHandler(logging.Handler):
    """A paused terminal or a full pipe blocks whoever writes to it; here that is a thread, and lines are dropped."""

    def __init__(self, target: logging.Handler, level: int, log_context: LogContext) -> None:
        super().__init__(level)
        self._target, self._log_context = target, log_context
        self._records: queue.Queue[logging.LogRecord] = queue.Queue(MAX_QUEUED_LINES)
        self._dropped = 0
        threading.Thread(target=self._write_loop, name="logs", daemon=True).start()

    def emit(self, record: logging.LogRecord) -> None:
        """Take a line, or count it where there are too many."""
        record.msg, record.args = record.getMessage(), None  # as it is now
        record.run, record.grasp = self._log_context.run, self._log_context.grasp
        try:
            self._records.put_nowait(record)
        except queue.Full:
            self._dropped += 1

    def close(self) -> None:
        """Wait for the last lines, but not for long."""
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


class _SilentRotatingFileHandler(RotatingFileHandler):
    """A full disk is told by an alarm; here its lines are lost."""

    def handleError(self, record: logging.LogRecord) -> None:
        """Nothing."""


def configure_logging(settings: LogSettings, data: Path, log_context: LogContext) -> None:
    """From here on, for the whole process; lines are about what `about` says when they are logged."""
    fields = ("levelname", "name", "message", "run", "grasp")
    as_json = JsonFormatter(fields, timestamp="at", rename_fields={"levelname": "level", "name": "logger"})
    as_text = logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s")
    output = logging.StreamHandler(sys.stderr)
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
