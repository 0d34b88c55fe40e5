"""People with tokens, for tests of a service that requires them."""

import re
from pathlib import Path

from app.messages.people import Role
from app.people import tokens
from config.load import CONFIG_DIR

NAMES = {Role.VIEWER: "Vera", Role.OPERATOR: "Otto", Role.ADMIN: "Ada"}


def give_tokens(data: Path) -> dict[Role, str]:
    """Add a person with a token for each role; return the tokens."""
    return {role: tokens.add_token(data, name, role) for role, name in NAMES.items()}


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


def config_with(folder: Path, **changes: float) -> Path:
    """Write the shipped settings with other values of existing keys; return the path."""
    text = (CONFIG_DIR / "graspwatch.toml").read_text()
    for key, value in changes.items():
        text, count = re.subn(rf"^{key} = [\d._]+", f"{key} = {value}", text, flags=re.MULTILINE)
        assert count == 1, key
    path = folder / "settings.toml"
    path.write_text(text)
    return path


# Least role for each route, stated a second time, so that no change opens one by mistake. None: open without a token.
RIGHTS: dict[tuple[str, str], Role | None] = {
    ("GET", "/api/health"): None,
    ("GET", "/api/session"): None,
    ("POST", "/api/session"): None,
    ("DELETE", "/api/session"): None,
    ("GET", "/api/control"): Role.VIEWER,
    ("POST", "/api/control"): Role.OPERATOR,
    ("DELETE", "/api/control"): Role.OPERATOR,
    ("POST", "/api/arm"): Role.OPERATOR,
    ("GET", "/api/calibration"): Role.VIEWER,
    ("POST", "/api/calibration"): Role.OPERATOR,
    ("POST", "/api/calibration/reading"): Role.OPERATOR,
    ("DELETE", "/api/calibration"): Role.OPERATOR,
    ("POST", "/api/disarm"): Role.OPERATOR,
    ("GET", "/api/configuration"): Role.VIEWER,
    ("GET", "/api/configuration/{kind}/{name}"): Role.VIEWER,
    ("POST", "/api/configuration/{kind}/check"): Role.OPERATOR,
    ("POST", "/api/configuration/{kind}"): Role.OPERATOR,
    ("DELETE", "/api/configuration/{kind}/{name}"): Role.OPERATOR,
    ("POST", "/api/configuration/tool/draft"): Role.ADMIN,
    ("POST", "/api/configuration/tool/{name}/use"): Role.ADMIN,
    ("GET", "/api/configuration/library/{name}/versions"): Role.VIEWER,
    ("POST", "/api/configuration/library/{name}/approval"): Role.ADMIN,
    ("POST", "/api/configuration/library/{name}/restore"): Role.OPERATOR,
    ("POST", "/api/spots"): Role.OPERATOR,
    ("POST", "/api/truth"): Role.OPERATOR,
    ("GET", "/api/lab-sessions"): Role.VIEWER,
    ("POST", "/api/lab-sessions"): Role.OPERATOR,
    ("PUT", "/api/lab-sessions/{session_id}"): Role.OPERATOR,
    ("DELETE", "/api/lab-sessions/current"): Role.OPERATOR,
    ("GET", "/api/runs/{run_id}/truth"): Role.VIEWER,
    ("PUT", "/api/runs/{run_id}/grasps/{grasp}/truth"): Role.OPERATOR,
    ("POST", "/api/marks"): Role.OPERATOR,
    ("GET", "/api/runs/{run_id}/marks"): Role.VIEWER,
    ("PUT", "/api/marks/{mark_id}"): Role.OPERATOR,
    ("DELETE", "/api/marks/{mark_id}"): Role.OPERATOR,
    ("POST", "/api/reference/decline"): Role.OPERATOR,
    ("GET", "/api/audit/check"): Role.VIEWER,
    ("GET", "/api/audit/export"): Role.ADMIN,
    ("POST", "/api/stop"): Role.VIEWER,
    ("GET", "/api/runs"): Role.VIEWER,
    ("POST", "/api/runs"): Role.OPERATOR,
    ("GET", "/api/runs/{run_id}"): Role.VIEWER,
    ("GET", "/api/runs/{run_id}/grasps"): Role.VIEWER,
    ("POST", "/api/runs/{run_id}/stop"): Role.VIEWER,
    ("GET", "/api/alarms"): Role.VIEWER,
    ("POST", "/api/alarms/{alarm_id}/acknowledge"): Role.OPERATOR,
    ("GET", "/api/alarms/history"): Role.VIEWER,
    ("GET", "/api/journal"): Role.VIEWER,
    ("GET", "/api/audit"): Role.VIEWER,
    ("GET", "/api/grasps"): Role.VIEWER,
    ("GET", "/api/grasps.{suffix}"): Role.VIEWER,
    ("GET", "/api/evaluation"): Role.VIEWER,
    ("GET", "/api/files"): Role.VIEWER,
    ("GET", "/api/tool"): Role.VIEWER,
    ("GET", "/api/protocols"): Role.VIEWER,
    ("GET", "/api/tissues"): Role.VIEWER,
    ("GET", "/api/system"): Role.VIEWER,
    ("GET", "/metrics"): Role.VIEWER,
    ("GET", "/api/recordings"): Role.VIEWER,
    ("GET", "/api/recordings/{name}/file"): Role.VIEWER,
    ("GET", "/api/recordings/{name}/report"): Role.VIEWER,
    ("DELETE", "/api/recordings/{name}"): Role.ADMIN,
    ("GET", "/api/bin"): Role.VIEWER,
    ("POST", "/api/bin/{entry}/restore"): Role.ADMIN,
    ("DELETE", "/api/bin"): Role.ADMIN,
    ("WEBSOCKET", "/api/recordings/{name}/replay"): Role.VIEWER,
    ("WEBSOCKET", "/api/live"): Role.VIEWER,
    ("GET", "/api/studies"): Role.VIEWER,
    ("POST", "/api/studies"): Role.OPERATOR,
    ("GET", "/api/studies/{study_id}"): Role.VIEWER,
    ("POST", "/api/studies/{study_id}/stop"): Role.OPERATOR,
    ("GET", "/api/studies/{study_id}/report"): Role.VIEWER,
    ("GET", "/api/studies/{study_id}/figures"): Role.VIEWER,
}
