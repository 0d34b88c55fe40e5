"""People with tokens, for tests of a service that asks for them."""

import re
from pathlib import Path

from app.people import tokens
from app.wire import Role
from config.load import CONFIG_DIR

NAMES = {Role.VIEWER: "Vera", Role.OPERATOR: "Otto", Role.ADMIN: "Ada"}


def give_tokens(data: Path) -> dict[Role, str]:
    """One for each role."""
    return {role: tokens.add(data, name, role) for role, name in NAMES.items()}


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


def config_with(folder: Path, **changes: float) -> Path:
    """The shipped settings with other values of keys that are in it."""
    text = (CONFIG_DIR / "graspwatch.toml").read_text()
    for key, value in changes.items():
        text, count = re.subn(rf"^{key} = [\d._]+", f"{key} = {value}", text, flags=re.MULTILINE)
        assert count == 1, key
    path = folder / "settings.toml"
    path.write_text(text)
    return path
