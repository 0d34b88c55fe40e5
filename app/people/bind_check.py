"""Functions that check, before a service starts, the address that it listens on, and its certificate."""

import ssl
from pathlib import Path

from app.people.tokens import TOKEN_FILE, read_tokens
from config.errors import ConfigurationError
from config.network import is_loopback

UNENCRYPTED_WARNING = (
    "Warning: tokens and all else travel unencrypted to other machines. Set --tls-cert and --tls-key, or put a proxy "
    "with TLS before a service that listens on 127.0.0.1."
)


def check_listen_address(host: str, data: Path, tls: bool) -> str | None:
    """Check that a service may listen on `host`; return a warning, if there is one.

    Raises:
        ConfigurationError: other computers can reach `host`, and no token is valid, or their file cannot be read.
    """
    people = read_tokens(data)
    if is_loopback(host):
        return None
    if not any(entry.is_valid for entry in people):
        raise ConfigurationError(
            f"On {host} others can reach the tool, and nobody has a good token in {data / TOKEN_FILE}. Make one with "
            f"`graspwatch token add NAME --role admin --data {data}`, or listen on 127.0.0.1."
        )
    return None if tls else UNENCRYPTED_WARNING


def check_certificate(cert: str | None, key: str | None) -> None:
    """Raise ConfigurationError if a file is missing, or the two are no certificate with its key."""
    if cert is None and key is None:
        return
    if cert is None or key is None:
        raise ConfigurationError("--tls-cert and --tls-key go together: set both or neither.")
    for path in (cert, key):
        if not Path(path).is_file():
            raise ConfigurationError(f"{path}: there is no such file. Check --tls-cert and --tls-key.")
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(cert, key, password=_no_password)
    except (ssl.SSLError, OSError) as error:
        raise ConfigurationError(
            f"{cert} and {key}: are no certificate with its key ({error.strerror or error}). Both are PEM files, the "
            "key without a password."
        ) from None


def _no_password() -> str:
    """Return no password, so that OpenSSL does not ask for one at the terminal."""
    return ""
