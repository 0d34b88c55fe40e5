"""`python deploy/build.py FOLDER`: carry out the steps of the Dockerfile in a folder, where there is no Docker engine.

All stages share one root, FOLDER: a path of the image is a path below it. Users cannot be made, nor images pulled;
Python is this one, Node is npm's. What comes out at FOLDER/opt/graspwatch is what the image would run.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

CHECKOUT = Path(__file__).parents[1]
OF_THE_IMAGE = re.compile(r"(?<![\w/.-])(?=/(?:build|opt|var)/)")


def steps(dockerfile: Path) -> Iterator[tuple[str, str]]:
    """Instructions and what follows them, continued lines joined."""
    text = re.sub(r"^\s*#.*\n", "", dockerfile.read_text(encoding="utf-8"), flags=re.MULTILINE)
    for line in text.replace("\\\n", " ").splitlines():
        if line.strip():
            instruction, _, rest = line.strip().partition(" ")
            yield instruction, " ".join(rest.split())


class Root:
    """Where the image's files would be."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._here = folder
        self._variables = {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}

    def _place(self, path: str) -> Path:
        return self._folder / path.lstrip("/") if path.startswith("/") else self._here / path

    def carry_out(self, instruction: str, rest: str) -> None:
        match instruction:
            case "WORKDIR":
                self._here = self._place(rest)
                self._here.mkdir(parents=True, exist_ok=True)
            case "ENV":
                for name, value in (each.split("=", 1) for each in shlex.split(rest)):
                    self._variables[name] = self._below(value).replace("$PATH", self._variables["PATH"])
            case "COPY":
                self._copy(shlex.split(rest))
            case "RUN":
                self._run(self._below(rest))

    def _below(self, text: str) -> str:
        return OF_THE_IMAGE.sub(str(self._folder), text)

    def _copy(self, words: list[str]) -> None:
        *sources, into = [each for each in words if not each.startswith("--")]
        stage = any(each.startswith("--from=") for each in words)
        for source in sources:
            path, to = self._place(source) if stage else CHECKOUT / source, self._place(into)
            if path == to:
                continue  # of another stage, which has the same root
            if path.is_dir():
                unwanted = shutil.ignore_patterns("node_modules", "__pycache__")
                shutil.copytree(path, to, dirs_exist_ok=True, ignore=unwanted)
            else:
                to = to / path.name if into.endswith("/") else to
                to.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(path, to)

    def _run(self, command: str) -> None:
        command = re.sub(r"^useradd .*? && ", "", command).replace("install -d -o graspwatch", "mkdir -p")
        subprocess.run(["sh", "-ec", command], cwd=self._here, env={**os.environ, **self._variables}, check=True)


def build(folder: Path) -> None:
    """Carry out the steps of the Dockerfile in a folder.

    Raises:
        CalledProcessError: a step failed.
    """
    root = Root(folder.resolve())
    for instruction, rest in steps(CHECKOUT / "Dockerfile"):
        print(f"{instruction} {rest}", file=sys.stderr, flush=True)
        root.carry_out(instruction, rest)


if __name__ == "__main__":
    build(Path(sys.argv[1]))
