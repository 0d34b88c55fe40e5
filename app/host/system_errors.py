"""Functions that report errors of the operating system and limits of the machine, each in one message."""

import contextlib
import errno
import os
import resource
import signal
import sys
from collections.abc import Iterator

from app.host.process_end import discard_output
from config.errors import ServiceError

MIN_ADDRESS_SPACE_BYTES = 1536 << 20
"""The server maps 1 GB of libraries, threads and memory, and so does the estimator with its reserve."""
LIBRARY_LOADING_LIMITS = (os.strerror(errno.EMFILE), os.strerror(errno.ENOMEM), "failed to map segment")
_ADVICE = {
    errno.EMFILE: "Raise the limit of open files (`ulimit -n`, LimitNOFILE= of systemd)",
    errno.ENFILE: "End other programs, or raise the system's limit of open files (fs.file-max)",
    errno.ENOSPC: "Free some space",
    errno.EDQUOT: "Free some space, or raise the quota",
    errno.EROFS: "Name a place that can be written to",
    errno.EACCES: "Check whose it is and its permissions",
    errno.EPERM: "Check whose it is and its permissions",
    errno.EAGAIN: "Raise the limit of processes and threads (`ulimit -u`, TasksMax= of systemd)",
    errno.ENOMEM: "Raise the limit of memory (`ulimit -v`, MemoryMax= of systemd), or end other programs",
}


@contextlib.contextmanager
def report_system_errors() -> Iterator[None]:
    """Print an error of the system or a limit of the machine raised inside, and exit with a ServiceError's code."""
    try:
        yield
    except KeyboardInterrupt:
        raise SystemExit(128 + signal.SIGINT) from None
    except (OSError, MemoryError, RuntimeError, ImportError) as error:
        if (text := describe_system_error(error)) is None:
            raise
        discard_output()
        with contextlib.suppress(OSError):  # nobody can be told
            print(f"Error: {text}", file=sys.stderr)
        raise SystemExit(ServiceError.exit_code) from None


def check_address_space() -> None:
    """Check that the limit of this process's address space (RLIMIT_AS) is enough for a service and its workers.

    Raises:
        ServiceError: it is not.
    """
    allowed, _ = resource.getrlimit(resource.RLIMIT_AS)
    if allowed != resource.RLIM_INFINITY and allowed < MIN_ADDRESS_SPACE_BYTES:
        raise ServiceError(
            f"The system allows each process {allowed >> 20} MB of address space, and a service needs "
            f"{MIN_ADDRESS_SPACE_BYTES >> 20} MB. Raise the limit (`ulimit -v`, LimitAS= of systemd), then start again."
        )


def describe_system_error(error: BaseException) -> str | None:
    """Return the message for an error of the operating system or for a limit of the machine; None for other errors."""
    if isinstance(error, MemoryError):
        return f"There is not enough memory. {_ADVICE[errno.ENOMEM]}."
    if isinstance(error, RuntimeError) and "start new thread" in str(error):
        return f"The system refuses another thread. {_ADVICE[errno.EAGAIN]}."
    if isinstance(error, ImportError) and any(text in str(error) for text in LIBRARY_LOADING_LIMITS):
        return f"A library cannot be loaded ({error}). Raise the limits of memory and of open files."
    if not isinstance(error, OSError):
        return None
    what = f"{os.fsdecode(error.filename)}: " if isinstance(error.filename, str | bytes) else "The system refuses: "
    advice = _ADVICE.get(error.errno or 0, "Check the path and the machine")
    return f"{what}{error.strerror or error}. {advice}, then repeat it."
