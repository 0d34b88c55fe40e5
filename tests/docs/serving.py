"""Stands for `graspwatch serve` in a page's commands: goes on in the background until the next one, or the page's end.

serving.py FOLDER PROGRAM [arguments]     start, and wait until it is ready; FOLDER keeps what must be known of it
serving.py FOLDER                         end it
"""

import os
import re
import signal
import ssl
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

READY_S = 90.0
UNVERIFIED = ssl.create_default_context()
UNVERIFIED.check_hostname, UNVERIFIED.verify_mode = False, ssl.CERT_NONE


def is_ready(url: str) -> bool:
    try:
        with urllib.request.urlopen(f"{url}/api/health", timeout=2.0, context=UNVERIFIED):
            return True
    except (urllib.error.URLError, OSError):
        return False


def end(known: Path) -> None:
    if known.exists():
        pid = int(known.read_text())
        os.kill(pid, signal.SIGTERM)
        while Path(f"/proc/{pid}/fd").exists() and any(Path(f"/proc/{pid}/fd").iterdir()):
            time.sleep(0.05)
        known.unlink()


def main(folder: Path, command: list[str]) -> int:
    known, said = folder / "serving.pid", folder / "serving.txt"
    end(known)
    if not command:
        return 0
    with said.open("w") as out:
        process = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL)
    end_s = time.monotonic() + READY_S
    while time.monotonic() < end_s and process.poll() is None:
        address = re.search(r"Dashboard: (https?://localhost:\d+)/", said.read_text())
        if address and is_ready(address[1]):
            known.write_text(str(process.pid))
            return 0
        time.sleep(0.1)
    print(said.read_text(), file=sys.stderr)
    return process.poll() or 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2:]))
