"""A real PostgreSQL server from Debian's package, for tests, in a temporary folder on its own socket."""

import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psycopg
import pytest

PORT = 54329  # not a network port: it only names the socket
OWNER = "postgres"  # Debian's user; the server refuses to run as root


def programs() -> Path | None:
    """Return the folder of the newest server's programs; None if no server is installed."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin"), key=lambda path: float(path.parent.name))
    return found[-1] if found else None


@contextmanager
def server() -> Iterator[str]:
    """Run a server; yield its address without a database. Without the package, skip the test, or fail it in CI."""
    binaries = programs()
    if binaries is None:
        if os.environ.get("CI") == "true":
            pytest.fail("PostgreSQL is not installed: apt install postgresql")
        pytest.skip("PostgreSQL is not installed (apt install postgresql)")
    folder = Path(tempfile.mkdtemp(prefix="graspwatch-pg-"))
    try:
        if os.getuid() == 0:
            owner = pwd.getpwnam(OWNER)
            os.chown(folder, owner.pw_uid, owner.pw_gid)
        data, log = folder / "data", folder / "log"
        _run(
            folder,
            binaries / "initdb",
            "-D",
            data,
            "-U",
            "tester",
            "-A",
            "scram-sha-256",
            "--pwfile",
            _word(folder),
            "-E",
            "UTF8",
            "--locale",
            "C.UTF-8",
            "--no-sync",
        )
        options = f"-p {PORT} -k {folder} -c listen_addresses='' -c fsync=off -c full_page_writes=off"
        _run(folder, binaries / "pg_ctl", "-D", data, "-l", log, "-o", options, "-w", "start")
        try:
            yield f"postgresql://tester:secret@/{{}}?host={folder}&port={PORT}"
        finally:
            _run(folder, binaries / "pg_ctl", "-D", data, "-m", "immediate", "-w", "stop")
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _word(folder: Path) -> Path:
    path = folder / "password"
    path.write_text("secret\n")
    path.chmod(0o644)
    return path


def _run(folder: Path, *command: str | Path) -> None:
    who = {"user": OWNER, "group": OWNER, "extra_groups": []} if os.getuid() == 0 else {}
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, **who)
    assert done.returncode == 0, f"{command}: {done.stdout}{done.stderr}"


def make_database(address: str, name: str) -> str:
    """Create an empty database; return its whole address."""
    with psycopg.connect(address.format("postgres"), autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {name}")
    return address.format(name)
