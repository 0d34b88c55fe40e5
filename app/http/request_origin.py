"""Where a request comes from: this computer, a proxy, a page of another site. Judged by the headers as they were sent.

Starlette's `request.url` puts the server's own address in the place of a `Host` that it cannot read. Here a header that
is missing, doubled or not well formed stands for nothing.
"""

from collections.abc import Collection
from ipaddress import ip_address, ip_network

from starlette.requests import HTTPConnection

from config.network import Authority, format_host, is_loopback, parse_authority
from config.schema import ServerSettings

LOCAL_HOSTS = ("localhost", "127.0.0.1", "[::1]")
FORWARDING_HEADERS = ("forwarded", "via", "x-real-ip", "x-client-ip", "true-client-ip", "cf-connecting-ip")
"""What proxies add; and everything that begins with `X-Forwarded`."""
SAME_ORIGIN_FETCH_SITES = ("same-origin", "none")
"""`Sec-Fetch-Site` of a request by the service's own page, and of an address that a person typed."""
DEFAULT_PORTS = {"http": 80, "https": 443}


def single_header(connection: HTTPConnection, name: str) -> str | None:
    """The value of a header that was sent exactly once, else None."""
    values = connection.headers.getlist(name)
    return values[0] if len(values) == 1 else None


def requested_host(connection: HTTPConnection) -> Authority | None:
    """By which name the service is asked (`Host`); None if that is missing, doubled or not well formed."""
    return parse_authority(single_header(connection, "host") or "")


def is_allowed_host(requested: Authority, connection: HTTPConnection, hosts: Collection[str]) -> bool:
    """Whether the service is asked by a name of its own: localhost, one of `hosts`, or the address it listens on."""
    server: tuple[str, int] | None = connection.scope.get("server")
    return requested.host in {*LOCAL_HOSTS, *hosts} or (server is not None and requested.host == format_host(server[0]))


def is_local_request(connection: HTTPConnection, hosts: Collection[str]) -> bool:
    """Whether a person or program on this computer asks: by address and by an allowed name, not through a proxy, and
    not because a page of another site says so."""
    asked, client, own_page = requested_host(connection), connection.client, is_same_origin(connection)
    if asked is None or client is None or forwarded_headers(connection):
        return False
    if own_page is None:  # browsers do not send `Origin` with all that they read
        own_page = all(each in SAME_ORIGIN_FETCH_SITES for each in connection.headers.getlist("sec-fetch-site"))
    return is_loopback(client.host) and is_allowed_host(asked, connection, hosts) and own_page


def forwarded_headers(connection: HTTPConnection) -> list[tuple[str, str]]:
    """What proxies say, or somebody in their name."""
    return [
        (name, value)
        for name, value in connection.headers.items()
        if name in FORWARDING_HEADERS or name.startswith("x-forwarded")
    ]


def is_same_origin(connection: HTTPConnection) -> bool | None:
    """Whether the page that asks (`Origin`) comes from this service; None where no page says that it asks.

    Name and port are compared, not http or https: a proxy before the service may end TLS.
    """
    if "origin" not in connection.headers:
        return None
    scheme, _, rest = (single_header(connection, "origin") or "").partition("://")
    page, asked, port = parse_authority(rest), requested_host(connection), DEFAULT_PORTS.get(scheme)
    if page is None or asked is None or port is None:
        return False
    return (page.host, page.port or port) == (asked.host, asked.port or port)


def is_encrypted(connection: HTTPConnection, server: ServerSettings) -> bool:
    """Whether the browser's connection is encrypted: ours, or the one to a proxy that the settings name."""
    if connection.scope["scheme"] == "https":
        return True
    client = connection.client
    trusted = client is not None and any(ip_address(client.host) in ip_network(each) for each in server.trusted_proxies)
    return trusted and single_header(connection, "x-forwarded-proto") == "https"
