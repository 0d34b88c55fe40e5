"""The service's eye on the chain of its journal: looks at the start and whenever somebody asks."""

import asyncio
import time
from pathlib import Path

from app.audit.chain_check import ChainCheckpoint, check_journal
from app.index.index_writer import IndexWriter
from app.messages.wire import JournalCheck, Priority
from app.stream.alarms import AlarmManager
from config.errors import GraspwatchError, JournalError

CHECK_CACHE_S = 5.0  # many pages may ask


class JournalWatch:
    """A chain that is broken is a low alarm: nothing is wrong with the tool, but somebody has to know."""

    def __init__(self, data: Path, index_writer: IndexWriter, alarms: AlarmManager) -> None:
        self._data, self._index_writer, self._alarms = data, index_writer, alarms
        self._check_lock = asyncio.Lock()
        self._last_check: JournalCheck | None = None
        self._last_check_s = 0.0
        self._startup_check = asyncio.create_task(self._check_at_startup())

    async def _check_at_startup(self) -> None:
        try:
            await self.check()
        except JournalError as error:
            self._alarms.raise_technical("audit", Priority.LOW, str(error))
        except GraspwatchError:
            pass  # the index has an alarm of its own

    async def check(self) -> JournalCheck:
        """What was found not long ago, or now.

        Raises:
            JournalError: the journal cannot be read.
            ServiceError: the index cannot be asked.
        """
        async with self._check_lock:
            if self._last_check is None or time.monotonic() - self._last_check_s > CHECK_CACHE_S:
                known = await self._index_writer.query(self._index_writer.store.list_chain_positions)
                self._last_check = await asyncio.to_thread(
                    check_journal, self._data, [ChainCheckpoint("the index", *each) for each in known]
                )
                self._last_check_s = time.monotonic()
                self._update_alarm(self._last_check)
            return self._last_check

    def _update_alarm(self, journal_check: JournalCheck) -> None:
        if journal_check.problem:
            text = f"The journal is not as it was written: {journal_check.problem}. Run `graspwatch audit verify`"
            self._alarms.raise_technical("audit", Priority.LOW, text)
        else:
            self._alarms.end("audit")

    async def aclose(self) -> None:
        """End a look that is under way."""
        self._startup_check.cancel()
        await asyncio.gather(self._startup_check, return_exceptions=True)
