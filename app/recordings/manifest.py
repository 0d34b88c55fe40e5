"""Functions that describe how a run was recorded: software, machine, and the SHA-256 of all that went in."""

import functools
import hashlib
import json
import platform
import subprocess
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, distribution, version
from pathlib import Path

from app import __version__
from app.audit.hash_chain import sha256_hex
from app.messages.recordings import RunManifest

VERSIONED_PACKAGES = ("numpy", "scipy", "numba", "nidaqmx", "mcap")  # their versions affect the recorded values
SOURCE_FOLDER = Path(__file__).parents[2]
GIT_TIMEOUT_S = 5.0


@functools.cache  # asked for twice at the start of each run
def collect_versions() -> dict[str, str]:
    """Return the versions of Graspwatch, Python and the computing packages."""
    return {"graspwatch": __version__, "python": platform.python_version(), "machine": platform.machine()} | {
        name: version(name) for name in VERSIONED_PACKAGES
    }


@functools.cache
def find_commit() -> str | None:
    """Return the commit of the program's source; it ends with `-dirty` if files differ from it. None: not known.

    The source is a git checkout, or pip noted the commit that it was installed from (PEP 610).
    """
    if (SOURCE_FOLDER / ".git").exists():
        command = ["git", "-C", str(SOURCE_FOLDER), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
        try:
            return subprocess.run(
                command, capture_output=True, text=True, timeout=GIT_TIMEOUT_S, check=True
            ).stdout.strip()
        except (OSError, subprocess.SubprocessError):  # no git, or a checkout of another user
            return None
    try:
        installed = json.loads(distribution("graspwatch").read_text("direct_url.json") or "{}")
    except (PackageNotFoundError, ValueError):
        return None
    return installed.get("vcs_info", {}).get("commit_id")


def build_manifest(
    metadata: Mapping[str, str], attachments: Mapping[str, bytes], realtime: Mapping[str, str]
) -> RunManifest:
    """Return the manifest of a recording with these metadata and attachments.

    `realtime`: the scheduling that the system granted each process.
    """
    return RunManifest(
        metadata=dict(metadata),
        commit=find_commit(),
        versions=collect_versions(),
        system=platform.platform(),
        realtime=dict(realtime),
        sha256={name: sha256_hex(content) for name, content in attachments.items()},
    )


def digest_file(path: Path) -> str:
    """Return the SHA-256 of a file, hexadecimal.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
