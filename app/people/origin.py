"""Where a request comes from: this machine, a proxy, a page of somebody else's."""

import ipaddress
from urllib.parse import urlsplit

from starlette.requests import HTTPConnection

FORWARDED = ("forwarded", "x-forwarded-for", "x-forwarded-host", "x-real-ip", "via")
PORTS = {"http": 80, "https": 443, "ws": 80, "wss": 443}


def comes_from_here(connection: HTTPConnection) -> bool:
    """By its address; not through a proxy, and not from a page that only gave itself the name of this machine."""
    if any(header in connection.headers for header in FORWARDED):
        return False
    client = connection.client
    return client is not None and is_loopback(client.host) and is_loopback(connection.url.hostname or "")


def is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def is_of_this_site(connection: HTTPConnection) -> bool | None:
    """Whether the page that asks comes from this service; None where no page says that it asks.

    Name and port are compared, not http or https: a proxy before the service may end TLS.
    """
    origin = connection.headers.get("origin")
    if origin is None:
        return None
    try:
        page, asked = urlsplit(origin), urlsplit(f"//{connection.headers.get('host', '')}")
        port = PORTS.get(page.scheme)
        return page.hostname is not None and (page.hostname, page.port or port) == (asked.hostname, asked.port or port)
    except ValueError:  # no port
        return False
