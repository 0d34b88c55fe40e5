"""Open an index for a service, before anything moves."""

from pathlib import Path

from sqlalchemy import URL

from app.store.rebuild import catch_up
from app.store.store import Store


def open_for_service(url: URL, data: Path) -> Store:
    """Up to date, claimed, and with the last lines of the journal that it lacks.

    Raises:
        ConfigurationError: PostgreSQL's driver is missing.
        ServiceError: it cannot be opened or written; the text says why and what to do next.
    """
    store = Store(url)
    try:
        catch_up(store, data)
    except BaseException:
        store.close()
        raise
    return store
