"""The films of the last few recordings: made when somebody asks, each once, shared by its viewers."""

import asyncio
import contextlib
import shutil
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from app.aside import run_aside
from app.plan import ServicePlan
from app.replay.film import Film
from app.replay.filming import make_film
from config.errors import RecordingError

ADVICE = "Open it again."
FILMS_KEPT = 4
PREFIX = ".film-"
LEFT_BEHIND_S = 3600.0  # no film takes as long: it is of a service that was killed

Key = tuple[Path, int, int]


@dataclass(slots=True)
class Showing:
    """A film that is there or on its way, and how many watch it."""

    film: "asyncio.Task[Film]"
    prepared: float = 0.0  # share of the recording that has been estimated
    viewers: int = 0

    @property
    def failed(self) -> bool:
        return self.film.done() and (self.film.cancelled() or self.film.exception() is not None)


class Films:
    """One is made at a time, in a process of its own; a file that has changed is a recording of its own."""

    def __init__(self, plan: ServicePlan) -> None:
        self._plan = plan
        self._showings: dict[Key, Showing] = {}  # the one that was asked for last comes last
        self._making = asyncio.Lock()
        for folder in plan.data.glob(f"{PREFIX}*"):
            if time.time() - folder.stat().st_mtime > LEFT_BEHIND_S:
                shutil.rmtree(folder, ignore_errors=True)

    @property
    def viewers(self) -> int:
        """Of all films."""
        return sum(showing.viewers for showing in self._showings.values())

    def watched(self, path: Path) -> bool:
        """Whether somebody watches a recording's film."""
        return any(showing.viewers for (film_of, _, _), showing in self._showings.items() if film_of == path)

    def forget(self, path: Path) -> None:
        """Let go of a recording's films that nobody watches, and of the room they take."""
        for key, showing in list(self._showings.items()):
            if key[0] == path and not showing.viewers:
                showing.film.cancel()
                del self._showings[key]

    @contextlib.contextmanager
    def watching(self, path: Path) -> Iterator[Showing]:
        """Be a viewer of a recording's film; it is made if need be, and no further when nobody waits for it any more.

        Raises:
            RecordingError: there is no such file.
        """
        try:
            stat = path.stat()
        except OSError as error:
            raise RecordingError(f"{path.name}: cannot be read ({error.strerror}).") from None
        key = path, stat.st_mtime_ns, stat.st_size
        showing = self._showings.pop(key, None)
        if showing is None or showing.failed:
            showing = Showing(asyncio.create_task(self._make(key)))
        self._showings[key] = showing
        showing.viewers += 1
        try:
            yield showing
        finally:
            showing.viewers -= 1
            self._tidy()

    def _tidy(self) -> None:
        """Let go of films that nobody waits for, failed ones, and the oldest of too many."""
        unwatched = [key for key, showing in self._showings.items() if not showing.viewers]
        for key in unwatched:
            showing = self._showings[key]
            if not showing.film.done():
                showing.film.cancel()
            if not showing.film.done() or showing.failed or len(self._showings) > FILMS_KEPT:
                del self._showings[key]

    async def _make(self, key: Key) -> Film:
        plan, path = self._plan, key[0]

        def prepared(share: float) -> None:
            self._showings[key].prepared = share

        async with self._making:
            with tempfile.TemporaryDirectory(prefix=PREFIX, dir=plan.data) as folder:
                asked = path, plan.recorded_with, plan.library, plan.settings, Path(folder)
                await run_aside("film", make_film, *asked, told=prepared, advice=ADVICE)
                return Film.open(Path(folder))  # on the disk until nobody watches it: its files need no names

    async def aclose(self) -> None:
        """End what is being made."""
        films = [showing.film for showing in self._showings.values()]
        for film in films:
            film.cancel()
        await asyncio.gather(*films, return_exceptions=True)
