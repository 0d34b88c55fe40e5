"""The errors that the Python client raises."""


class ClientError(Exception):
    """Base of the errors that the Python client raises."""


class UnreachableError(ClientError):
    """Error: no service answers at the address, or not in time."""


class RefusedError(ClientError):
    """Error: the service refused the request; the error's text gives the reason.

    `status` is the HTTP status (401: no valid token, 403: not permitted, 409: not now, 422: a field is wrong, 503: the
    tool does not answer). `fields` maps each faulty field to its reason.
    """

    def __init__(self, status: int, detail: str, fields: dict[str, str]) -> None:
        super().__init__(detail)
        self.status, self.detail, self.fields = status, detail, fields


class ConnectionLostError(ClientError):
    """Error: the stream ended, because service or connection ended. The tool's state is not known any more.

    `last_event` is the number of the last event received, None if there was none: `messages(after=...)` goes on there.
    """

    def __init__(self, text: str, last_event: int | None = None) -> None:
        super().__init__(text)
        self.last_event = last_event
