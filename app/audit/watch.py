"""The service's eye on the chain of its journal: looks at the start and whenever somebody asks."""

import asyncio
import time
from pathlib import Path

from app.alarms import AlarmBook
from app.audit.check import Witness, check
from app.store.keeper import Index
from app.wire import JournalCheck, Priority
from config.errors import GraspwatchError, JournalError

KEPT_S = 5.0  # many pages may ask


class ChainWatch:
    """A chain that is broken is a low alarm: nothing is wrong with the tool, but somebody has to know."""

    def __init__(self, data: Path, index: Index, alarms: AlarmBook) -> None:
        self._data, self._index, self._alarms = data, index, alarms
        self._one = asyncio.Lock()
        self._found: JournalCheck | None = None
        self._found_s = 0.0
        self._first_look = asyncio.create_task(self._look_first())

    async def _look_first(self) -> None:
        try:
            await self.look()
        except JournalError as error:
            self._alarms.raise_technical("audit", Priority.LOW, str(error))
        except GraspwatchError:
            pass  # the index has an alarm of its own

    async def look(self) -> JournalCheck:
        """What was found not long ago, or now.

        Raises:
            JournalError: the journal cannot be read.
            ServiceError: the index cannot be asked.
        """
        async with self._one:
            if self._found is None or time.monotonic() - self._found_s > KEPT_S:
                known = await self._index.ask(self._index.store.chained)
                self._found = await asyncio.to_thread(
                    check, self._data, [Witness("the index", *each) for each in known]
                )
                self._found_s = time.monotonic()
                self._tell(self._found)
            return self._found

    def _tell(self, found: JournalCheck) -> None:
        if found.problem:
            text = f"The journal is not as it was written: {found.problem}. Run `graspwatch audit verify`"
            self._alarms.raise_technical("audit", Priority.LOW, text)
        else:
            self._alarms.end("audit")

    async def aclose(self) -> None:
        """End a look that is under way."""
        self._first_look.cancel()
        await asyncio.gather(self._first_look, return_exceptions=True)
