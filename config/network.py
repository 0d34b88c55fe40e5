"""Functions for host names and addresses: parse an authority (RFC 3986, `host:port`), recognize this computer."""

import ipaddress
import re
import socket
from typing import NamedTuple

_LABEL = r"[a-z0-9_]([a-z0-9_-]{0,61}[a-z0-9_])?"
_HOST = rf"{_LABEL}(\.{_LABEL})*|\[[0-9a-f:.]+\]"
_AUTHORITY = re.compile(rf"(?P<host>{_HOST})(:(?P<port>[1-9][0-9]{{0,4}}))?", re.IGNORECASE | re.ASCII)
MAX_HOST_LENGTH = 253
MAX_PORT = 65_535


class Authority(NamedTuple):
    """Host in lower case, an IPv6 address in brackets, and port; None for the scheme's default port."""

    host: str
    port: int | None = None


def parse_authority(text: str) -> Authority | None:
    """Parse `host` or `host:port`; return None if the text is anything else.

    Names are ASCII without a final dot (an international one in its `xn--` form), IPv6 addresses are in brackets. User
    names, spaces, empty ports and zones are refused; nothing is repaired or ignored.
    """
    found = _AUTHORITY.fullmatch(text)
    if found is None:
        return None
    host, port = found["host"].lower(), int(found["port"] or 0)
    if len(host) > MAX_HOST_LENGTH or port > MAX_PORT or (host.startswith("[") and not _is_ipv6(host[1:-1])):
        return None
    return Authority(host, port or None)


def format_host(address: str) -> str:
    """Return a socket's address or a name as the host of an authority: an IPv6 address in brackets."""
    return f"[{address}]" if ":" in address and not address.startswith("[") else address


def reachable_host(address: str) -> str:
    """Return the host by which this computer reaches a service that listens on `address`."""
    return "localhost" if address in ("127.0.0.1", "0.0.0.0", "::", "[::]") else format_host(address)


def is_loopback(host: str) -> bool:
    """Return whether a program that listens on `host` (a name or an address) is reached from this computer alone."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def is_this_computer(host: str) -> bool:
    """Return whether a connection to `host` stays on this computer, so that it needs no proxy.

    This holds for `localhost` and names that end in it (RFC 6761), 127.0.0.0/8 also in its short forms (127.1), ::1,
    and the unspecified address. No name is looked up.
    """
    name = host.strip("[]").rstrip(".").lower()
    if name == "localhost" or name.endswith(".localhost"):
        return True
    try:
        address = ipaddress.ip_address(name.partition("%")[0])
    except ValueError:
        try:
            address = ipaddress.ip_address(socket.inet_aton(name))
        except (OSError, ValueError):
            return False
    if isinstance(address, ipaddress.IPv6Address) and address.ipv4_mapped:
        address = address.ipv4_mapped
    return address.is_loopback or address.is_unspecified


def _is_ipv6(text: str) -> bool:
    try:
        ipaddress.IPv6Address(text)
    except ValueError:
        return False
    return True
