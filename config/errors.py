"""The errors a user can meet. Each text says what is wrong and what to do next; each leaf has its exit code."""


class GraspwatchError(Exception):
    """Base of every error that is told to the user in one message, without a traceback."""

    exit_code = 1


class ConfigurationError(GraspwatchError):
    """A configuration, tool, library or protocol file is wrong, or a name does not exist."""

    exit_code = 2


class RecordingError(GraspwatchError):
    """A recording cannot be read: names the file, the line and what was expected there."""

    exit_code = 3


class ToolError(GraspwatchError):
    """The board or the grasper is missing, failed, or answered with an error."""

    exit_code = 4


class RefusedError(GraspwatchError):
    """A request the tool must not or cannot carry out now (beyond limits, already running).

    `field` names the part of the request at fault.
    """

    exit_code = 5

    def __init__(self, text: str, field: str = "protocol") -> None:
        super().__init__(text)
        self.field = field


class ServiceError(GraspwatchError):
    """The service cannot start or lost a worker (port taken, worker dead)."""

    exit_code = 6


class JournalError(GraspwatchError):
    """The journal is not as it was written, or cannot be read: names the first place and what is wrong there."""

    exit_code = 7


class CalibrationError(GraspwatchError):
    """What was measured gives no trustworthy calibration: names what is wrong and what to do; nothing was written."""

    exit_code = 8
