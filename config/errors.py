"""The errors a user can meet. Each text says what is wrong and what to do next; each class has its exit code."""

import errno


class GraspwatchError(Exception):
    """Base of every error that the user sees as one message, without a traceback."""

    exit_code = 1


class ConfigurationError(GraspwatchError):
    """Error: a settings, tool, library or protocol file is wrong, or a name does not exist."""

    exit_code = 2


class RecordingError(GraspwatchError):
    """Error: a recording cannot be read. The text names the file, the line and the expected content."""

    exit_code = 3


class ToolError(GraspwatchError):
    """Error: the board or the grasper is missing, failed, or answered with an error."""

    exit_code = 4


class RefusedError(GraspwatchError):
    """Error: the tool must not or cannot execute a request now (beyond limits, already running).

    `field` names the faulty part of the request.
    """

    exit_code = 5

    def __init__(self, text: str, field: str = "protocol") -> None:
        super().__init__(text)
        self.field = field


class ServiceError(GraspwatchError):
    """Error: the service cannot start or lost a worker (port taken, worker dead)."""

    exit_code = 6


class JournalError(GraspwatchError):
    """Error: the journal was changed or cannot be read. The text names the first faulty place."""

    exit_code = 7


class CalibrationError(GraspwatchError):
    """Error: the measurement gives no reliable calibration. The text says what to do; no file was written."""

    exit_code = 8


def build_write_error(text: str, cause: OSError, kind: type[GraspwatchError] = ConfigurationError) -> GraspwatchError:
    """Return the error for a file that cannot be written: a ServiceError on a full disk or quota, else of `kind`."""
    return (ServiceError if cause.errno in (errno.ENOSPC, errno.EDQUOT) else kind)(text)
