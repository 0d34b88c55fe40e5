"""The function that sets the headers of a page of results: total number, and links to the other pages (RFC 8288)."""

from urllib.parse import quote, urlencode

from fastapi import Request, Response


def set_paging_headers(request: Request, response: Response, limit: int, offset: int, total: int) -> None:
    """Set `X-Total-Count` and `Link` in the response."""
    pages = {"first": 0, "last": max(total - 1, 0) // limit * limit}
    if offset > 0:
        pages["prev"] = max(offset - limit, 0)
    if offset + limit < total:
        pages["next"] = offset + limit
    response.headers["X-Total-Count"] = str(total)
    response.headers["Link"] = ", ".join(f'<{_page_url(request, limit, at)}>; rel="{rel}"' for rel, at in pages.items())


def _page_url(request: Request, limit: int, offset: int) -> str:
    """Return the page's address without scheme and host, which a proxy may have changed."""
    asked = [(name, value) for name, value in request.query_params.multi_items() if name not in ("limit", "offset")]
    return f"{quote(request.scope['path'])}?{urlencode([*asked, ('limit', limit), ('offset', offset)])}"
