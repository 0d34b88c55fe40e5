"""The class JournalWatch, which checks the service's journal when the service starts, and on request."""

import asyncio
import time
from pathlib import Path

from app.audit.chain_check import ChainCheckpoint, check_journal
from app.index.index_writer import IndexWriter
from app.messages.journal import JournalCheck
from app.stream.alarms import AlarmManager
from config.errors import GraspwatchError, JournalError
from estimator.force_alarms import Priority

CHECK_CACHE_S = 5.0  # many pages may ask at once


class JournalWatch:
    """The journal's check with its alarm, whose priority is low: a broken chain does not affect the tool."""

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
        """Check the journal, or return the last result if it is at most CHECK_CACHE_S old.

        Raises:
            JournalError: the journal cannot be read.
            ServiceError: the index cannot be queried.
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
        text = f"The journal is not as it was written: {journal_check.problem}. Run `graspwatch audit verify`"
        self._alarms.update_technical("audit", Priority.LOW, text if journal_check.problem else None)

    async def aclose(self) -> None:
        """Cancel the check at the start if it is under way."""
        self._startup_check.cancel()
        await asyncio.gather(self._startup_check, return_exceptions=True)
