"""The class RecordingBin: deletes, restores and removes recordings; the journal records each removal beforehand."""

import asyncio
import logging
from datetime import UTC, datetime, timedelta
from pathlib import Path

from app.analysis.report.report_cache import ReportCache
from app.host.bin_folder import BinFolder, BinnedFile, find_expired, format_iso
from app.index.queries import FileQuery
from app.messages.journal import JournalKind
from app.messages.recordings import BinContent, BinnedRecording, Emptied, FileRecord
from app.recordings.index_reader import describe_file
from app.recordings.replay.cache_store import ReplayCacheStore
from app.service.tool_service import ToolService
from config.errors import GraspwatchError, ServiceError
from config.service_plan import ServicePlan

EXPIRY_CHECK_PERIOD_S = 3600.0
MAX_RECORDS_QUERIED = 500  # the newest deletions; the journal says who deleted older recordings
JOURNAL_FAULT_TEXT = (
    "The journal cannot be written, and nothing is deleted without a line in it. Make room by other means."
)


class RecordingBin:
    """The service's bin of deleted recordings; once an hour it removes those older than `keep_deleted_days`."""

    def __init__(
        self,
        plan: ServicePlan,
        tool_service: ToolService,
        replay_cache_store: ReplayCacheStore,
        report_cache: ReportCache,
    ) -> None:
        self._bin_folder, self._keep_days = BinFolder(plan.recordings_folder), plan.settings.recording.keep_deleted_days
        self._tool_service, self._replay_cache_store, self._report_cache = (
            tool_service,
            replay_cache_store,
            report_cache,
        )
        self._bin_lock = asyncio.Lock()
        self._expiry_task = asyncio.create_task(self._run_expiry_loop())
        tool_service.tasks.watch(self._expiry_task)

    async def list_content(self) -> BinContent:
        """Return the deleted recordings, with who deleted each.

        Raises:
            ServiceError: the index cannot be queried.
        """
        files = await asyncio.to_thread(self._bin_folder.list_files)
        index = self._tool_service.index_writer
        known = await index.query(index.store.find_files, FileQuery(deleted=True, limit=MAX_RECORDS_QUERIED))
        by = {(record.name, record.deleted_at): record.deleted_by for record in known.items}
        recordings = [
            BinnedRecording(
                entry=file.entry,
                name=file.name,
                size_bytes=file.size_bytes,
                deleted_at=file.deleted_at_iso,
                deleted_by=by.get((file.name, file.deleted_at_iso)),
                expires_at=format_iso(file.deleted_at + timedelta(days=self._keep_days)),
            )
            for file in files
        ]
        return BinContent(
            recordings=recordings, size_bytes=sum(file.size_bytes for file in files), keep_days=self._keep_days
        )

    async def delete(self, path: Path, by: str) -> None:
        """Move a recording into the bin, and discard its replay cache and its reports; the caller checks for users.

        Raises:
            ServiceError: the recording cannot be moved, or the journal cannot be written; the recording stays.
        """
        async with self._bin_lock:
            journal, name, at = self._tool_service.journal, path.name, datetime.now(UTC)
            before = await self._find_file_record(path)
            gone = before.model_copy(update={"deleted_at": format_iso(at), "deleted_by": by})
            if not journal.write(JournalKind.DELETED, f"Recording {name} is being deleted", by=by, file=gone):
                journal.write(JournalKind.DELETED, f"Recording {name} stays", by=by, file=before)
                raise ServiceError(JOURNAL_FAULT_TEXT)
            await asyncio.gather(self._tool_service.index_writer.wait_until_written(), journal.wait_until_synced())
            self._replay_cache_store.discard(path)
            await self._report_cache.discard(path)
            try:
                await asyncio.to_thread(self._bin_folder.add, path, at)
            except OSError as error:
                text = f"Recording {name} could not be deleted: {error.strerror}"
                journal.write(JournalKind.DELETED, text, by=by, file=before)
                raise ServiceError(f"{text}. Allow writing in its folder.") from None
            self._tool_service.publisher.publish_event(
                f"Recording {name} deleted: it is in the bin", JournalKind.EVENT, by
            )

    async def find(self, entry: str) -> BinnedFile:
        """Return an entry of the bin.

        Raises:
            RefusedError: there is no such entry.
        """
        return await asyncio.to_thread(self._bin_folder.find, entry)

    async def restore(self, file: BinnedFile, by: str) -> FileRecord:
        """Move a deleted recording back into the recordings folder, and return its record.

        Raises:
            RefusedError: a recording of the same name exists.
            ServiceError: the recording cannot be moved, or the index cannot be queried.
        """
        async with self._bin_lock:
            index = self._tool_service.index_writer
            known = await index.query(index.store.get_file, file.name)
            try:
                path = await asyncio.to_thread(self._bin_folder.restore, file)
            except OSError as error:
                raise ServiceError(f"{file.name} could not be restored: {error.strerror}.") from None
            same = known is not None and known.deleted_at == file.deleted_at_iso
            record = known if known and same else await asyncio.to_thread(describe_file, path)
            record = record.model_copy(update={"deleted_at": None, "deleted_by": None})
            text = f"Recording {file.name} restored"
            self._tool_service.journal.write(JournalKind.RESTORED, text, by=by, file=record)
            self._tool_service.publisher.publish_event(text, JournalKind.EVENT, by)
            await index.wait_until_written()
            return record

    async def empty(self, by: str) -> Emptied:
        """Remove all recordings in the bin permanently.

        Raises:
            ServiceError: a recording cannot be removed, or the journal cannot be written.
        """
        async with self._bin_lock:
            emptied = await self._remove(await asyncio.to_thread(self._bin_folder.list_files), by)
            if emptied.removed:
                self._tool_service.publisher.publish_event(
                    f"Bin emptied of {emptied.removed} recordings", JournalKind.EVENT, by
                )
            return emptied

    async def aclose(self) -> None:
        self._expiry_task.cancel()
        await asyncio.gather(self._expiry_task, return_exceptions=True)

    async def _run_expiry_loop(self) -> None:
        while True:
            try:
                async with self._bin_lock:
                    files = await asyncio.to_thread(self._bin_folder.list_files)
                    await self._remove(find_expired(files, self._keep_days, datetime.now(UTC)), None)
            except (GraspwatchError, OSError) as error:
                logging.getLogger("graspwatch").warning("what is too old stays in the bin: %s", error)
            await asyncio.sleep(EXPIRY_CHECK_PERIOD_S)

    async def _remove(self, files: list[BinnedFile], by: str | None) -> Emptied:
        """Remove files permanently, after a journal line for each; `by` is None if they expired."""
        why = "" if by else f" after {self._keep_days:g} days"
        for file in files:
            text = f"Recording {file.name}, deleted {file.deleted_at_iso}, is being removed from the bin{why}"
            if not self._tool_service.journal.write(JournalKind.EMPTIED, text, by=by):
                raise ServiceError(JOURNAL_FAULT_TEXT)
        await self._tool_service.journal.wait_until_synced()
        try:
            for file in files:
                await asyncio.to_thread(self._bin_folder.delete_permanently, file)
        except OSError as error:
            raise ServiceError(f"The bin could not be emptied ({error.strerror}: {error.filename}).") from None
        return Emptied(removed=len(files), freed_bytes=sum(file.size_bytes for file in files))

    async def _find_file_record(self, path: Path) -> FileRecord:
        """Return the index's record of a recording, or one from the disk if the index has no current record."""
        index = self._tool_service.index_writer
        known = await index.query(index.store.get_file, path.name)
        return known if known and not known.deleted_at else await asyncio.to_thread(describe_file, path)
