"""Requests of all kinds, made up from the API's own description, by nobody and by each role.

None fails inside, and nobody gets beyond their rights.
"""

import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from people import RIGHTS, bearer, config_with, give_tokens
from schemathesis import GenerationMode
from service import Service

from app.messages.people import Role
from config.load import CONFIG_DIR

EXAMPLES = {GenerationMode.POSITIVE: 6, GenerationMode.NEGATIVE: 4}
CAN_BE_WRONG = 15  # operations that take something which can be wrong
UNKNOWN, FORBIDDEN = 401, 403
NO_JSON = 400, 422  # what is none at all is refused before the role is looked at
TOO_LARGE = 413  # of a body that is refused before it is read

ADMINS_KINDS = {  # a tool file decides forces and limits
    ("POST", "/api/configuration/{kind}", "tool"): Role.ADMIN,
    ("DELETE", "/api/configuration/{kind}/{name}", "tool"): Role.ADMIN,
}


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return tmp_path_factory.mktemp("data")


@pytest.fixture(scope="module")
def token(data):
    return give_tokens(data)


@pytest.fixture(scope="module")
def service(data, token, tmp_path_factory):
    config = config_with(tmp_path_factory.mktemp("config"), requests_per_s=10_000, burst_requests=10_000)
    with Service("serve", "--host", "0.0.0.0", "--config", str(config), data=data) as running:
        yield running


@pytest.fixture(scope="module")
def operations(service, token):
    no_tokens_made_up = schemathesis.Config.from_dict({"generation": {"with-security-parameters": False}})
    schema = schemathesis.openapi.from_url(
        f"{service.url}/openapi.json", config=no_tokens_made_up, headers=bearer(token[Role.VIEWER])
    )
    found = [result.ok() for result in schema.get_all_operations()]
    described = {(each.method.upper(), each.path) for each in found}
    assert all(each.definition.raw.get("x-role") == RIGHTS[each.method.upper(), each.path] for each in found)
    assert described == {route for route in RIGHTS if route[0] != "WEBSOCKET" and route[1] != "/metrics"}
    return found


@pytest.mark.parametrize("mode", EXAMPLES)
@pytest.mark.parametrize("role", [None, *Role])
def test_nobody_breaks_anything_or_does_what_he_may_not(service, token, operations, role, mode):
    if mode is GenerationMode.NEGATIVE:  # any text is a good part of a path
        operations = [each for each in operations if len(each.body) or len(each.query)]
    assert len(operations) >= CAN_BE_WRONG
    for operation in operations:
        check(operation, mode, role, service.url, bearer(token[role]) if role else {})
    assert service.ready()


def test_operators_save_and_delete_files_but_only_admins_tool_files(service, token):
    for kind, folder, name in (("protocol", "protocols", "sine"), ("tool", "tools", "simulated")):
        text = (CONFIG_DIR / folder / f"{name}.toml").read_text().replace(f'name = "{name}"', 'name = "mine"', 1)
        for role in Role:
            may = role is Role.ADMIN or (role is Role.OPERATOR and kind == "protocol")
            headers, path = bearer(token[role]), f"/api/configuration/{kind}"
            saved = service.http.post(path, json={"text": text}, headers=headers)
            assert saved.status_code == (201 if may else FORBIDDEN), (kind, role)
            deleted = service.http.delete(f"{path}/mine", headers=headers)
            assert deleted.status_code == (200 if may else FORBIDDEN), (kind, role)


def check(operation, mode, role, url, headers):
    least = RIGHTS[operation.method.upper(), operation.path]

    @settings(
        max_examples=EXAMPLES[mode],
        deadline=None,
        database=None,
        derandomize=True,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(case=operation.as_strategy(mode))
    def answered(case):
        needed = ADMINS_KINDS.get((operation.method.upper(), operation.path, case.path_parameters.get("kind")), least)
        may = needed is None or (role is not None and role.includes(needed))
        response = case.call(base_url=url, headers=headers, allow_redirects=False)
        said = f"{case.as_curl_command()}: {response.status_code} {response.content[:300]!r}"
        assert response.status_code < 500, said
        if not may:
            assert response.status_code in ((FORBIDDEN, TOO_LARGE, *NO_JSON) if role else (UNKNOWN,)), said
        elif needed is not None:
            assert response.status_code not in (UNKNOWN, FORBIDDEN), said

    answered()
