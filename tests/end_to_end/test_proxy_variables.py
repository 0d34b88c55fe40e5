"""A service on this computer is asked directly, whatever the proxy variables say: no token leaves it."""

import os
import subprocess
import sys
import zipfile

import pytest
from people import give_tokens
from proxy import HttpProxy
from service import PROGRAM, Service

from app.messages.people import Role

VARIABLES = ["http_proxy", "HTTP_PROXY", "https_proxy", "HTTPS_PROXY", "all_proxy", "ALL_PROXY"]
OURS = ["localhost", "LOCALHOST", "127.0.0.1", "127.9.9.9", "127.1", "[::1]", "0.0.0.0"]
CLIENT = """
import asyncio, sys
from graspwatch import Graspwatch

async def main(token, *urls):
    for url in urls:
        async with Graspwatch(url, token=token) as tool:
            told = await anext(tool.messages())
            print((await tool.session()).name, told.type)

asyncio.run(main(*sys.argv[1:]))
"""


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return tmp_path_factory.mktemp("data")


@pytest.fixture(scope="module")
def token(data):
    return give_tokens(data)[Role.VIEWER]


@pytest.fixture(scope="module")
def service(data, token):
    """On all addresses of this machine, those of IPv6, too."""
    with Service("serve", "--host", "::", data=data) as running:
        yield running


@pytest.fixture
def proxy(service):
    with HttpProxy(service.port) as running:
        yield running


def said(command, variables, proxy, **more):
    environment = {name: value for name, value in os.environ.items() if not name.lower().endswith("_proxy")}
    environment |= dict.fromkeys(variables, proxy.url) | more
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("variable", VARIABLES)
def test_the_client_asks_this_computer_directly(service, token, proxy, variable):
    urls = [f"http://{host}:{service.port}" for host in OURS]
    told = said([sys.executable, "-c", CLIENT, token, *urls], [variable], proxy)
    assert (told.splitlines(), proxy.asked) == (["Vera hello"] * len(OURS), [])


def test_the_client_asks_another_computer_through_the_proxy(service, token, proxy):
    told = said([sys.executable, "-c", CLIENT, token, "http://grasp.example:8000"], VARIABLES, proxy)
    assert told == "Vera hello\n"
    assert [line.split(" ")[:2] for line in proxy.asked] == [
        ["CONNECT", "grasp.example:8000"],
        ["GET", "http://grasp.example:8000/api/session"],
    ]


@pytest.mark.parametrize("host", ["localhost", "[::1]", "grasp.example"])
def test_support_tells_no_proxy_what_is_asked_here(service, data, token, proxy, tmp_path, host):
    out, url = tmp_path / "help.zip", f"http://{host}:{service.port}"
    command = [PROGRAM, "support", "--data", data, "--out", out, "--url", url]
    said(command, VARIABLES, proxy, GRASPWATCH_TOKEN=token)
    with zipfile.ZipFile(out) as parts:
        assert b'"ready"' in parts.read("service/health.json")
        assert b'"versions"' in parts.read("service/system.json")
    assert bool(proxy.asked) == (host == "grasp.example")
