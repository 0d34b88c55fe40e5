"""The decorator that compiles functions with numba, and keeps them in a cache that can only make a start faster.

A cache that is damaged, out of date, of other code or impossible leads to compilation, never to an error. Code of
another function, signature or version is never executed: each file says what it was compiled from.
"""

import functools
import hashlib
import logging
import multiprocessing
import os
import pickle
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba import config, njit
from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    IndexDataCacheFile,
    InTreeCacheLocator,
    UserProvidedCacheLocator,
    UserWideCacheLocator,
)

from config.atomic_write import open_atomically

FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])

SOURCE_PACKAGES = ("acquisition", "config", "estimator")
NAME_DIGITS = 16
DIGEST_BYTES = hashlib.sha256().digest_size
HOME = os.path.expanduser("~")

numba_config: Any = config  # it declares no variables
numba_config.CACHE_DIR = os.path.expanduser(numba_config.CACHE_DIR)


def compiled(function: FunctionT) -> FunctionT:
    """Decorate a function so that its first call compiles it or loads it from the cache.

    Division by zero gives infinity and does not raise; `is_healthy` then finds that the filter has diverged.
    """
    dispatcher: Any = njit(error_model="numpy")(function)
    try:
        dispatcher._cache = _CheckedFunctionCache(function)  # noqa: SLF001 - as `enable_caching` does with numba's own
    except RuntimeError:  # numba found no place
        if multiprocessing.parent_process() is None:  # the program says it for its workers
            warn_once(
                "There is no folder in which compiled filters can be kept, so each start compiles them, which takes up "
                "to a minute. Set NUMBA_CACHE_DIR to a folder that you can write to, and others cannot."
            )
    return dispatcher


@functools.cache
def warn_once(text: str) -> None:
    logging.getLogger("graspwatch").warning(text)


@functools.cache
def hash_sources() -> str:
    """Return the hash of all sources: numba itself only regards the function's own file, not its constants' files."""
    root, digest = Path(__file__).parents[1], hashlib.sha256(numba.__version__.encode())
    for path in sorted(path for package in SOURCE_PACKAGES for path in (root / package).rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


class _CheckedCacheFile(IndexDataCacheFile):
    """One file for each signature, without numba's index, which may name the file of another version or signature.

    A file holds its checksum, the hash of the sources, the key (signature, processor, bytecode) and the compiled code.
    A damaged file, or one of other sources or of another key, counts as missing and is written anew.
    """

    def save(self, key: Any, data: Any) -> None:
        content = self._dump((self._source_stamp, key, data))
        with open_atomically(self._path(key)) as file:
            file.write(hashlib.sha256(content).digest() + content)

    def load(self, key: Any) -> Any:
        stamp, known_key, data = self._read(self._path(key)) or (None, None, None)
        return data if (stamp, known_key) == (self._source_stamp, key) else None

    def _path(self, key: Any) -> Path:
        return Path(
            self._data_path(self._data_name(int(hashlib.sha256(repr(key).encode()).hexdigest()[:NAME_DIGITS], 16)))
        )

    def _read(self, path: Path) -> Any:
        try:
            content = path.read_bytes()
        except OSError:
            return None
        if hashlib.sha256(content[DIGEST_BYTES:]).digest() != content[:DIGEST_BYTES]:
            warn_once(f"The cache of compiled filters in {self._cache_path} is damaged; it is made anew.")
            return None
        return pickle.loads(content[DIGEST_BYTES:])


class _SafePlace:
    """A place for the cache to which no other user can write: whoever writes there decides what this program executes.

    The owner may be this user, root, or the owner of the sources.
    """

    @classmethod
    def from_function(cls, function: Callable[..., Any], source_path: str) -> Any:
        place = super().from_function(function, source_path)  # type: ignore[misc]
        if place is None:
            return None
        found = os.stat(place.get_cache_path())
        is_safe = found.st_uid in {os.geteuid(), 0, os.stat(source_path).st_uid} and not found.st_mode & stat.S_IWOTH
        return place if is_safe else None


class _CacheImpl(CompileResultCacheImpl):
    """The places for the cache. Without a home folder numba would make a folder called `~`."""

    _locator_classes = [  # noqa: RUF012 - numba's
        type(place.__name__, (_SafePlace, place), {})
        for place in [UserProvidedCacheLocator, InTreeCacheLocator] + [UserWideCacheLocator] * os.path.isabs(HOME)
    ]


class _CheckedFunctionCache(FunctionCache):
    _impl_class = _CacheImpl

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file = _CheckedCacheFile(self._cache_path, f"{self._impl.filename_base}-checked", hash_sources())

    def _save_overload(self, sig: Any, data: Any) -> None:
        try:
            super()._save_overload(sig, data)
        except OSError as error:
            warn_once(f"Compiled filters cannot be kept in {self._cache_path}: {error.strerror}.")
