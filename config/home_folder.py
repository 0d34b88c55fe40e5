"""Functions that expand `~` as a shell does, for settings, tool files, variables and quoted arguments."""

import os
import re

from config.errors import ConfigurationError

_HOME = re.compile(r"(?:^|(?<=[=,]))~[\w.-]*(?=/|,|$)")


def expand_home(path: str) -> str:
    """Return a path with the home folder in the place of a leading `~` or `~user`.

    Raises:
        ConfigurationError: there is no such home folder.
    """
    found = _HOME.match(path)
    if not found:
        return path
    home = os.path.expanduser(found[0])
    if not os.path.isabs(home):
        raise ConfigurationError(f"{path}: there is no such home folder. Write the path in full, or set HOME.")
    return home + path[found.end() :]


def expand_home_in_argument(argument: str) -> str:
    """Return an argument with `~` or `~user` expanded, also after `=` and commas, as in `liver=~/a,~/b`."""
    return _HOME.sub(lambda found: expand_home(found[0]), argument)
