"""Deleting recordings, bringing them back, and removing them for good: each with a line in the journal before it."""

import asyncio
import logging
from datetime import UTC, datetime, timedelta
from pathlib import Path

from app.bin import Bin, BinnedFile, expired, iso
from app.plan import ServicePlan
from app.replay.films import Films
from app.report.reports import Reports
from app.station import Station
from app.store.questions import FileQuestion
from app.wire import BinContent, BinnedRecording, Emptied, FileRecord, JournalKind
from config.errors import GraspwatchError, ServiceError

EXPIRY_EVERY_S = 3600.0
MOST_NAMED = 500  # deleted last; who deleted the others stands in the journal
NO_JOURNAL = "The journal cannot be written, and nothing is deleted without a line in it. Make room by other means."


class RecordingBin:
    """One for a service; it removes what is older than the settings say, once an hour."""

    def __init__(self, plan: ServicePlan, station: Station, films: Films, reports: Reports) -> None:
        self._bin, self._keep_days = Bin(plan.recordings_folder), plan.settings.recording.keep_deleted_days
        self._station, self._films, self._reports = station, films, reports
        self._one = asyncio.Lock()
        self._tidying = asyncio.create_task(self._tidy())
        station.watch_over(self._tidying)

    async def content(self) -> BinContent:
        """
        Raises:
            ServiceError: the index cannot be asked.
        """
        files = await asyncio.to_thread(self._bin.files)
        index = self._station.index
        known = await index.ask(index.store.files, FileQuestion(deleted=True, limit=MOST_NAMED))
        by = {(record.name, record.deleted_at): record.deleted_by for record in known.items}
        recordings = [
            BinnedRecording(
                entry=file.entry,
                name=file.name,
                size_bytes=file.size_bytes,
                deleted_at=file.deleted_iso,
                deleted_by=by.get((file.name, file.deleted_iso)),
                expires_at=iso(file.deleted_at + timedelta(days=self._keep_days)),
            )
            for file in files
        ]
        return BinContent(
            recordings=recordings, size_bytes=sum(file.size_bytes for file in files), keep_days=self._keep_days
        )

    async def delete(self, path: Path, by: str) -> None:
        """Move a recording that nobody uses into the bin, and let go of its film and its reports.

        Raises:
            ServiceError: it cannot be moved, or not be written down; it stays.
        """
        async with self._one:
            journal, name, at = self._station.journal, path.name, datetime.now(UTC)
            before = await self._record(path)
            gone = before.model_copy(update={"deleted_at": iso(at), "deleted_by": by})
            if not journal.write(JournalKind.DELETED, f"Recording {name} is being deleted", by=by, file=gone):
                journal.write(JournalKind.DELETED, f"Recording {name} stays", by=by, file=before)
                raise ServiceError(NO_JOURNAL)
            await asyncio.gather(self._station.index.settled(), journal.synced())
            self._films.forget(path)
            await self._reports.forget(path)
            try:
                await asyncio.to_thread(self._bin.put, path, at)
            except OSError as error:
                text = f"Recording {name} could not be deleted: {error.strerror}"
                journal.write(JournalKind.DELETED, text, by=by, file=before)
                raise ServiceError(f"{text}. Allow writing in its folder.") from None
            self._station.tell_event(f"Recording {name} deleted: it is in the bin", JournalKind.EVENT, by)

    async def find(self, entry: str) -> BinnedFile:
        """
        Raises:
            RefusedError: there is no such entry.
        """
        return await asyncio.to_thread(self._bin.find, entry)

    async def restore(self, file: BinnedFile, by: str) -> FileRecord:
        """Move a recording back to where it was.

        Raises:
            RefusedError: there is a recording of its name.
            ServiceError: it cannot be moved, or the index not be asked.
        """
        async with self._one:
            index = self._station.index
            known = await index.ask(index.store.file, file.name)
            try:
                path = await asyncio.to_thread(self._bin.restore, file)
            except OSError as error:
                raise ServiceError(f"{file.name} could not be restored: {error.strerror}.") from None
            same = known is not None and known.deleted_at == file.deleted_iso
            record = known if known and same else await asyncio.to_thread(_seen, path)
            record = record.model_copy(update={"deleted_at": None, "deleted_by": None})
            text = f"Recording {file.name} restored"
            self._station.journal.write(JournalKind.RESTORED, text, by=by, file=record)
            self._station.tell_event(text, JournalKind.EVENT, by)
            await index.settled()
            return record

    async def empty(self, by: str) -> Emptied:
        """Remove all that is in the bin, for good.

        Raises:
            ServiceError: something cannot be removed, or not be written down.
        """
        async with self._one:
            emptied = await self._remove(await asyncio.to_thread(self._bin.files), by)
            if emptied.removed:
                self._station.tell_event(f"Bin emptied of {emptied.removed} recordings", JournalKind.EVENT, by)
            return emptied

    async def aclose(self) -> None:
        self._tidying.cancel()
        await asyncio.gather(self._tidying, return_exceptions=True)

    async def _tidy(self) -> None:
        while True:
            try:
                async with self._one:
                    files = await asyncio.to_thread(self._bin.files)
                    await self._remove(expired(files, self._keep_days, datetime.now(UTC)), None)
            except (GraspwatchError, OSError) as error:
                logging.getLogger("graspwatch").warning("what is too old stays in the bin: %s", error)
            await asyncio.sleep(EXPIRY_EVERY_S)

    async def _remove(self, files: list[BinnedFile], by: str | None) -> Emptied:
        """`by` None: it was there for long enough."""
        why = "" if by else f" after {self._keep_days:g} days"
        for file in files:
            text = f"Recording {file.name}, deleted {file.deleted_iso}, is being removed from the bin{why}"
            if not self._station.journal.write(JournalKind.EMPTIED, text, by=by):
                raise ServiceError(NO_JOURNAL)
        await self._station.journal.synced()
        try:
            for file in files:
                await asyncio.to_thread(self._bin.remove, file)
        except OSError as error:
            raise ServiceError(f"The bin could not be emptied ({error.strerror}: {error.filename}).") from None
        return Emptied(removed=len(files), freed_bytes=sum(file.size_bytes for file in files))

    async def _record(self, path: Path) -> FileRecord:
        """As the index knows it, else what the disk says."""
        index = self._station.index
        known = await index.ask(index.store.file, path.name)
        return known if known and not known.deleted_at else await asyncio.to_thread(_seen, path)


def _seen(path: Path) -> FileRecord:
    """What the disk says of a recording that the index does not know."""
    found = path.lstat()
    return FileRecord(
        name=path.name,
        run_id=None,
        size_bytes=found.st_size,
        made_at=datetime.fromtimestamp(found.st_mtime, UTC).isoformat(timespec="milliseconds"),
        duration_s=None,
        samples=None,
        lost_samples=None,
        format_version=None,
        condition=None,
        problem=None,
    )
