"""The program in surroundings that are narrower than usual: limits of the machine, signals, a full disk."""

import os
import resource
import signal
import subprocess
from pathlib import Path

import pytest
from service import PROGRAM, Service, until

from app.service import supervisor
from app.service.supervisor import make_socket_folder
from config.errors import ServiceError

NARROW = (
    "setsid",
    "unshare",
    "-m",
    "sh",
    "-c",
    'mount -t tmpfs -o ro none /dev/shm && exec env TMPDIR="$0" prlimit --rttime=150000:150000 --nofile=200:200 '
    'setpriv --bounding-set=-sys_resource --inh-caps=-sys_resource "$@"',
)


def test_a_service_gets_ready_under_low_limits_and_ends_with_its_terminal(tmp_path: Path) -> None:
    """Real-time CPU time, open files, no shared memory, a long temporary folder; then SIGHUP to all processes."""
    folder = tmp_path / ("long" * 20)
    folder.mkdir()
    with Service(within=(*NARROW, str(folder))) as service:
        assert set(service.conditions().values()) == {"running"}
        limits = resource.prlimit(service.worker("acquisition"), resource.RLIMIT_RTTIME)
        assert limits == (150_000, 150_000)
        os.killpg(service.process.pid, signal.SIGHUP)
        _, error = service.process.communicate(timeout=30)
        assert service.process.returncode == 128 + signal.SIGHUP
        lines = [line for line in error.splitlines() if not line.startswith(("Graspwatch ", "Preparing "))]
        assert lines == []


@pytest.mark.parametrize(
    ("limit", "value", "says"),
    [
        (resource.RLIMIT_NOFILE, 100, "allows 100 open files"),
        (resource.RLIMIT_AS, 800 << 20, "800 MB of address space"),
    ],
)
def test_a_limit_that_is_too_low_is_told_before_an_address(tmp_path: Path, limit: int, value: int, says: str) -> None:
    done = subprocess.run(
        [PROGRAM, "serve", "--port", "0", "--data", tmp_path],
        capture_output=True,
        text=True,
        timeout=60,
        preexec_fn=lambda: resource.setrlimit(limit, (value, value)),
    )
    assert (done.returncode, done.stdout) == (6, "")
    assert says in done.stderr
    assert done.stderr.startswith("Error: ")


def test_a_full_disk_under_the_output_is_told() -> None:
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run([PROGRAM, "--version"], stdout=full, stderr=subprocess.PIPE, text=True, timeout=60)
    assert done.returncode == 6
    assert done.stderr == "Error: The system refuses: No space left on device. Free some space, then repeat it.\n"


def catches(pid: int, number: signal.Signals) -> bool:
    caught = Path(f"/proc/{pid}/status").read_text().partition("SigCgt:")[2].split()[0]
    return bool(int(caught, 16) >> (number - 1) & 1)


@pytest.mark.parametrize(
    ("words", "number"),
    [
        (["run", "trapezoid_2hz", "--tissue", "liver", "--cycles", "1000", "--real-time"], signal.SIGHUP),
        (["study", "paper", "--jobs", "2"], signal.SIGTERM),
    ],
)
def test_a_signal_ends_a_command_quietly(tmp_path: Path, words: list[str], number: signal.Signals) -> None:
    program = subprocess.Popen(
        [PROGRAM, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path, process_group=0
    )
    if "study" in words:
        until(lambda: len(Path(f"/proc/{program.pid}/task/{program.pid}/children").read_text().split()) == 2)
    else:
        until(lambda: catches(program.pid, number))
    program.send_signal(number)
    try:
        out, error = program.communicate(timeout=60)
    except subprocess.TimeoutExpired:
        os.killpg(program.pid, signal.SIGKILL)
        raise
    assert (program.returncode, out, error) == (128 + number, "", "")
    with pytest.raises(ProcessLookupError):
        os.killpg(program.pid, 0)


def test_sockets_have_a_folder_with_a_short_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    long = tmp_path / ("long" * 20)
    long.mkdir()
    for temporary in (str(long), str(tmp_path / "missing"), "~nobody-has-this-name/x", ""):
        monkeypatch.setenv("TMPDIR", temporary)
        with make_socket_folder(long) as folder:
            assert len(folder) <= supervisor.MAX_SOCKET_FOLDER_BYTES + len("/graspwatch-12345678")
    monkeypatch.setattr(supervisor, "SOCKET_PLACES", ("/proc/none",))
    with pytest.raises(ServiceError, match=r"/proc/none \(No such file or directory\).*Set TMPDIR"):
        make_socket_folder(long)
