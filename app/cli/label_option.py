"""The option `--label`, which assigns recordings to tissues."""

import glob
import re
from pathlib import Path
from typing import Any

from typer.core import TyperCommand

from config.errors import ConfigurationError

LABEL_OPTION = "--label"
TISSUE_NAME_PATTERN = re.compile(r"[a-z0-9][a-z0-9_]*")
RESERVED_NAMES = ("unknown", "undecided")


class LearnCommand(TyperCommand):
    """A command that also accepts `--label liver=a b c`: files that follow a label belong to it."""

    # `ctx` is click's context, or in newer versions of typer the one of its own copy of click
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, expand_label_arguments(args))

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
        name, equals, files = text.partition("=")
        name = name.strip().lower().replace("-", "_").replace(" ", "_")
        if not equals or not files.strip():
            raise ConfigurationError(
                f"--label {text}: expected TISSUE=FILE, for example --label liver=liver4Hz1.lvm.gz. Name at least one "
                "recording for each tissue."
            )
        if not TISSUE_NAME_PATTERN.fullmatch(name) or name in RESERVED_NAMES:
            why = "is reserved for grasps that fit no tissue" if name in RESERVED_NAMES else "is no name for a tissue"
            raise ConfigurationError(f"--label {text}: {name!r} {why}. Use letters, digits and underscores.")
        result.setdefault(name, []).extend(_expand_file_patterns(files, text))
    return result


def _expand_file_patterns(text: str, label: str) -> list[Path]:
    if Path(text).exists():
        return [Path(text)]
    found: list[Path] = []
    for part in text.split(","):
        part = part.strip()
        if not part:
            continue
        if Path(part).exists() or not glob.has_magic(part):
            found.append(Path(part))
            continue
        matches = sorted(glob.glob(part))
        if not matches:
            raise ConfigurationError(f"--label {label}: no file fits {part!r}. Check the path.")
        found += [Path(match) for match in matches]
    return found
