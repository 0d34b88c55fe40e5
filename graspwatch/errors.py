"""What can go wrong between a program and a service."""


class ClientError(Exception):
    """Any of them."""


class UnreachableError(ClientError):
    """Nobody answers at the address, or not in time."""


class RefusedError(ClientError):
    """The service answered, and refuses: why is the error's text.

    `status` is that of HTTP (401: who are you, 403: you may not, 409: not now, 422: a field is wrong, 503: the tool
    does not answer); `fields` names each field at fault and why.
    """

    def __init__(self, status: int, detail: str, fields: dict[str, str]) -> None:
        super().__init__(detail)
        self.status, self.detail, self.fields = status, detail, fields


class ConnectionLostError(ClientError):
    """The stream ended: the service was ended, or the connection broke. Nothing is known of the tool any more."""
