"""Functions that normalize and check names of tissues, as a person types them.

A name becomes part of names of columns, of fields of messages and of variables in MATLAB. So it is an identifier of
small letters, digits and underscores, short enough for all of these.
"""

import re
from collections.abc import Iterable

from config.errors import ConfigurationError

MAX_LENGTH = 30  # with the longest addition, a column's name has at most the 63 characters of a variable in MATLAB
RESERVED_NAMES = ("unknown", "undecided", "no_answer")
COLUMN_NAMES = ("jaw", "probability_unknown", "threshold_n", "tick")  # with them, two columns would have one name
_PATTERN = re.compile(r"[a-z][a-z0-9_]*")


def normalize_tissue_name(text: str, where: str) -> str:
    """Return the name of a tissue as the program writes it, from what a person typed: `Small bowel`, `small-bowel`.

    Raises:
        ConfigurationError: it can be no name of a tissue; the text begins with `where`.
    """
    name = re.sub(r"[\s-]+", "_", text.strip().lower())
    if fault := find_name_fault(name):
        raise ConfigurationError(f"{where}: {fault}")
    return name


def find_name_fault(name: str) -> str | None:
    """Return why this cannot be the name of a tissue, in a sentence, or None."""
    if name in RESERVED_NAMES:
        return f"{name!r} is reserved for grasps that fit no tissue. Give the tissue another name."
    if name in COLUMN_NAMES:
        return f"{name!r} is part of the names of other columns. Give the tissue another name."
    if not _PATTERN.fullmatch(name):
        return (
            f"{name!r} is no name for a tissue: small letters, digits and underscores only, with a letter first. Name "
            "it so."
        )
    if len(name) > MAX_LENGTH:
        return f"{name!r} has {len(name)} characters; a tissue's name has at most {MAX_LENGTH}. Shorten it."
    return None


def check_tissue_names(names: Iterable[str], where: str) -> None:
    """Refuse names that cannot stand in one library.

    Raises:
        ConfigurationError: one can be no name of a tissue, or two differ only in underscores, which some formats leave
            out; the text begins with `where`.
    """
    seen: dict[str, str] = {}
    for name in names:
        if fault := find_name_fault(name):
            raise ConfigurationError(f"{where}: {fault}")
        other = seen.setdefault(name.replace("_", ""), name)
        if other != name:
            raise ConfigurationError(
                f"{where}: {other!r} and {name!r} differ only in underscores, which some formats leave out. Rename one."
            )
