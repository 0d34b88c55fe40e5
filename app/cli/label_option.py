"""The option `--label`, which assigns recordings to tissues: the same in all commands."""

import fnmatch
import glob
from collections.abc import Callable
from pathlib import Path
from typing import Any

from typer.core import TyperCommand

from acquisition.recordings.file_names import remove_recording_suffix
from config.errors import ConfigurationError
from config.tissue_names import normalize_tissue_name

LABEL_OPTION = "--label"
LABEL_METAVAR = "TISSUE=FILE..."
LABEL_HELP = (
    "Recordings of a tissue; repeat it for each tissue. Files may follow one another, be separated by commas, or be a "
    "pattern."
)


class LabelCommand(TyperCommand):
    """A command that also accepts `--label liver=a b c`: files that follow a label belong to it."""

    # `ctx` is click's context, or in newer versions of typer the one of its own copy of click
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, expand_label_arguments(args))


class LearnCommand(LabelCommand):
    """The same, for a command whose recordings all have a label."""

    def format_usage(self, ctx: Any, formatter: Any) -> None:
        formatter.write_usage(ctx.command_path, "[OPTIONS] --label TISSUE=FILE... --label TISSUE=FILE... --out FILE")


def expand_label_arguments(args: list[str]) -> list[str]:
    """Replace each file that follows a label by a `--label` argument of its own."""
    result: list[str] = []
    label: str | None = None
    before = ""
    for arg in args:
        named = before == LABEL_OPTION or arg.startswith(f"{LABEL_OPTION}=")
        if named:
            label = arg.removeprefix(f"{LABEL_OPTION}=").partition("=")[0]
        elif arg.startswith("-"):
            label = None
        elif label is not None:
            arg = f"{LABEL_OPTION}={label}={arg}"
        result.append(arg)
        before = arg
    return result


def parse_labels(labels: list[str]) -> dict[str, list[Path]]:
    """Return each tissue's files from `TISSUE=FILE`, `TISSUE=FILE,FILE` and patterns such as `TISSUE=liver*.lvm.gz`.

    Raises:
        ConfigurationError: a label has no file or no valid tissue name, or a pattern matches no file.
    """
    result: dict[str, list[Path]] = {}
    for text in labels:
        name, files = _split_label(text)
        for part in _split_names(files, lambda each: Path(each).exists()):
            result.setdefault(name, []).extend(_expand_pattern(part, text))
    return result


def parse_labels_of(labels: list[str], files: list[Path]) -> list[tuple[str, list[Path]]]:
    """Return the tissue and the recordings of each label, in the labels' order.

    A label names one of `files` by its path, its name with or without its ending, or a pattern of these. It names
    another recording by its path, or by a pattern of paths.

    Raises:
        ConfigurationError: a label has no file or no valid tissue name, or names no recording, or more than one
            without a pattern.
    """
    result = []
    known = [_list_names(path) for path in files]
    for text in labels:
        name, names = _split_label(text)
        parts = _split_names(names, lambda each: Path(each).is_file() or any(each in of_one for of_one in known))
        result.append((name, [path for part in parts for path in _find_recordings(part, text, files)]))
    return result


def _split_label(text: str) -> tuple[str, str]:
    name, equals, files = text.partition("=")
    if not equals or not files.strip():
        raise ConfigurationError(
            f"--label {text}: expected TISSUE=FILE, for example --label liver=liver4Hz1.lvm.gz. Name at least one "
            "recording for each tissue."
        )
    return normalize_tissue_name(name, f"--label {text}"), files


def _split_names(text: str, is_known: Callable[[str], bool]) -> list[str]:
    """Return the names between the commas; a comma may be part of a known name."""
    if is_known(text):
        return [text]
    parts = text.split(",")
    names: list[str] = []
    while parts:
        longest = next((n for n in range(len(parts), 1, -1) if is_known(",".join(parts[:n]).strip())), 1)
        names.append(",".join(parts[:longest]).strip())
        del parts[:longest]
    return [name for name in names if name]


def _expand_pattern(part: str, label: str) -> list[Path]:
    if Path(part).exists() or not glob.has_magic(part):
        return [Path(part)]
    matches = sorted(glob.glob(part))
    if not matches:
        raise ConfigurationError(f"--label {label}: no file fits {part!r}. Check the path.")
    return [Path(match) for match in matches]


def _list_names(path: Path) -> tuple[str, ...]:
    return str(path), path.name, remove_recording_suffix(path.name)


def _find_recordings(part: str, label: str, files: list[Path]) -> list[Path]:
    exact = [path for path in files if part in _list_names(path)]
    if len(exact) == 1:
        return exact
    if exact:
        raise ConfigurationError(f"--label {label}: {part!r} is {len(exact)} of the recordings. Give its path.")
    if Path(part).is_file():
        return [Path(part)]
    fitting = [path for path in files if any(fnmatch.fnmatchcase(name, part) for name in _list_names(path))]
    fitting = fitting or [path for path in map(Path, sorted(glob.glob(part))) if path.is_file()]
    if fitting and glob.has_magic(part):
        return fitting
    raise ConfigurationError(f"--label {label}: {part!r} is none of the recordings of this report.")
