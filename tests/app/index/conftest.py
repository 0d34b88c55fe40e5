import itertools
from collections.abc import Callable, Iterator
from pathlib import Path

import postgresql
import pytest
from sqlalchemy import URL

from app.index.database import resolve_index_url
from app.index.store import Store

NUMBERS = itertools.count()


@pytest.fixture(scope="session")
def server() -> Iterator[str]:
    with postgresql.server() as address:
        yield address


@pytest.fixture(params=["sqlite", "postgresql"])
def new_url(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[[], URL]:
    """Addresses of new, empty databases, of one kind and of the other."""
    address = request.getfixturevalue("server") if request.param == "postgresql" else None

    def make() -> URL:
        name = f"index_{next(NUMBERS)}"
        setting = postgresql.make_database(address, name) if address else f"sqlite:///{tmp_path}/{name}.sqlite"
        return resolve_index_url(setting, tmp_path)

    return make


@pytest.fixture
def url(new_url: Callable[[], URL]) -> URL:
    return new_url()


@pytest.fixture
def store(url: URL) -> Iterator[Store]:
    store = Store(url)
    yield store
    store.close()
