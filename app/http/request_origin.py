"""Functions that judge a request's origin by its headers as sent: this computer, a proxy, a page of another site.

Starlette's `request.url` replaces an unreadable `Host` with the server's own address. Here a header that is missing,
repeated or malformed counts as absent.
"""

from collections.abc import Collection
from ipaddress import ip_address, ip_network

from starlette.requests import HTTPConnection

from config.network import Authority, format_host, is_loopback, parse_authority
from config.schema import ServerSettings

LOCAL_HOSTS = ("localhost", "127.0.0.1", "[::1]")
FORWARDING_HEADERS = ("forwarded", "via", "x-real-ip", "x-client-ip", "true-client-ip", "cf-connecting-ip")
"""Headers that proxies add, besides every header that begins with `X-Forwarded`."""
SAME_ORIGIN_FETCH_SITES = ("same-origin", "none")
"""Values of `Sec-Fetch-Site` for a request of the service's own page, and for a typed address."""
DEFAULT_PORTS = {"http": 80, "https": 443}


def single_header(connection: HTTPConnection, name: str) -> str | None:
    """Return the value of a header that was sent exactly once, else None."""
    values = connection.headers.getlist(name)
    return values[0] if len(values) == 1 else None


def requested_host(connection: HTTPConnection) -> Authority | None:
    """Return the host that the request addresses (`Host`); None if it is missing, repeated or malformed."""
    return parse_authority(single_header(connection, "host") or "")


def is_allowed_host(requested: Authority, connection: HTTPConnection, hosts: Collection[str]) -> bool:
    """Return whether `requested` is localhost, one of `hosts`, or the address that the service listens on."""
    server: tuple[str, int] | None = connection.scope.get("server")
    return requested.host in {*LOCAL_HOSTS, *hosts} or (server is not None and requested.host == format_host(server[0]))


def is_local_request(connection: HTTPConnection, hosts: Collection[str]) -> bool:
    """Return whether a local client sent the request to an allowed host, without a proxy or a foreign page."""
    asked, client, own_page = requested_host(connection), connection.client, is_same_origin(connection)
    if asked is None or client is None or forwarded_headers(connection):
        return False
    if own_page is None:  # browsers omit `Origin` in many read requests
        own_page = all(each in SAME_ORIGIN_FETCH_SITES for each in connection.headers.getlist("sec-fetch-site"))
    return is_loopback(client.host) and is_allowed_host(asked, connection, hosts) and own_page


def forwarded_headers(connection: HTTPConnection) -> list[tuple[str, str]]:
    """Return the headers that proxies add; a client may have forged them."""
    return [
        (name, value)
        for name, value in connection.headers.items()
        if name in FORWARDING_HEADERS or name.startswith("x-forwarded")
    ]


def is_same_origin(connection: HTTPConnection) -> bool | None:
    """Return whether the requesting page (`Origin`) belongs to this service; None without `Origin`.

    The scheme is not compared, because a proxy in front of the service may end TLS.
    """
    if "origin" not in connection.headers:
        return None
    scheme, _, rest = (single_header(connection, "origin") or "").partition("://")
    page, asked, port = parse_authority(rest), requested_host(connection), DEFAULT_PORTS.get(scheme)
    if page is None or asked is None or port is None:
        return False
    return (page.host, page.port or port) == (asked.host, asked.port or port)


def is_encrypted(connection: HTTPConnection, server: ServerSettings) -> bool:
    """Return whether the browser's connection is encrypted, to the service or to a trusted proxy."""
    if connection.scope["scheme"] == "https":
        return True
    client = connection.client
    trusted = client is not None and any(ip_address(client.host) in ip_network(each) for each in server.trusted_proxies)
    return trusted and single_header(connection, "x-forwarded-proto") == "https"
