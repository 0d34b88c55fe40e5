"""The user of this computer as whom the program runs."""

import getpass
import os


def computer_user_name() -> str:
    """Return the name of the user, or the number where the system has no name for it, as in a container."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return f"user {os.getuid()}"
