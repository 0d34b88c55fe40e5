"""The class ReplayCacheStore: each replay cache is built on request, once, and shared by its viewers."""

import asyncio
import contextlib
import shutil
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from app.host.background_process import run_in_background_process
from app.recordings.replay.cache_builder import build_replay_cache
from app.recordings.replay.replay_cache import ReplayCache
from config.errors import RecordingError
from config.service_plan import ServicePlan

RETRY_ADVICE = "Open it again."
MAX_CACHES = 4
FOLDER_PREFIX = ".film-"
STALE_FOLDER_AGE_S = 3600.0  # no build takes as long: it is of a service that was killed

CacheKey = tuple[Path, int, int]


@dataclass(slots=True)
class ReplayCacheEntry:
    """A replay cache that is built or being built, and the number of its viewers."""

    build_task: "asyncio.Task[ReplayCache]"
    prepared_share: float = 0.0  # share of the recording that has been estimated
    viewers: int = 0

    @property
    def failed(self) -> bool:
        return self.build_task.done() and (self.build_task.cancelled() or self.build_task.exception() is not None)


class ReplayCacheStore:
    """Store that builds one cache at a time, in a separate process; a changed file gets another cache."""

    def __init__(self, plan: ServicePlan) -> None:
        self._plan = plan
        self._entries: dict[CacheKey, ReplayCacheEntry] = {}  # the last requested one comes last
        self._build_lock = asyncio.Lock()
        for folder in plan.data_folder.glob(f"{FOLDER_PREFIX}*"):
            if time.time() - folder.stat().st_mtime > STALE_FOLDER_AGE_S:
                shutil.rmtree(folder, ignore_errors=True)

    @property
    def viewers(self) -> int:
        """Number of viewers of all caches."""
        return sum(showing.viewers for showing in self._entries.values())

    def is_watched(self, path: Path) -> bool:
        """Return whether a recording has viewers."""
        return any(showing.viewers for (film_of, _, _), showing in self._entries.items() if film_of == path)

    def discard(self, path: Path) -> None:
        """Discard a recording's caches without viewers, and free their disk space."""
        for key, showing in list(self._entries.items()):
            if key[0] == path and not showing.viewers:
                showing.build_task.cancel()
                del self._entries[key]

    @contextlib.contextmanager
    def open_entry(self, path: Path) -> Iterator[ReplayCacheEntry]:
        """Yield a recording's cache entry for one more viewer; a build is canceled when its last viewer leaves.

        Raises:
            RecordingError: there is no such file.
        """
        try:
            stat = path.stat()
        except OSError as error:
            raise RecordingError(f"{path.name}: cannot be read ({error.strerror}).") from None
        key = path, stat.st_mtime_ns, stat.st_size
        showing = self._entries.pop(key, None)
        if showing is None or showing.failed:
            showing = ReplayCacheEntry(asyncio.create_task(self._build(key)))
        self._entries[key] = showing
        showing.viewers += 1
        try:
            yield showing
        finally:
            showing.viewers -= 1
            self._evict()

    def _evict(self) -> None:
        """Discard unfinished and failed caches without viewers, and the oldest of too many."""
        unwatched = [key for key, showing in self._entries.items() if not showing.viewers]
        for key in unwatched:
            showing = self._entries[key]
            if not showing.build_task.done():
                showing.build_task.cancel()
            if not showing.build_task.done() or showing.failed or len(self._entries) > MAX_CACHES:
                del self._entries[key]

    async def _build(self, key: CacheKey) -> ReplayCache:
        plan, path = self._plan, key[0]

        def prepared(share: float) -> None:
            self._entries[key].prepared_share = share

        async with self._build_lock:
            with tempfile.TemporaryDirectory(prefix=FOLDER_PREFIX, dir=plan.data_folder) as folder:
                asked = path, plan.recording_tool, plan.library, plan.settings, Path(folder)
                await run_in_background_process(
                    "film", build_replay_cache, *asked, on_message=prepared, advice=RETRY_ADVICE
                )
                return ReplayCache.open(Path(folder))  # its open files stay until the last viewer leaves

    async def aclose(self) -> None:
        """Cancel all builds."""
        tasks = [entry.build_task for entry in self._entries.values()]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
