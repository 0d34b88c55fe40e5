"""The class LabSessions: the laboratory session under way, to which runs belong, and changes of earlier ones."""

import asyncio
import re
import secrets
from datetime import UTC, datetime
from typing import Any

from app.index.store import Store
from app.messages.journal import JournalKind
from app.messages.lab_sessions import LabSession, LabSessionChange, LabSessionRequest
from app.service.publisher import Publisher
from config.errors import ConfigurationError, RefusedError
from config.schema import LaboratorySettings, ToolKind

CHANGEABLE = ("subject", "species", "specimen", "condition", "operator", "protocol_number", "notes", "fields")


class LabSessions:
    """The laboratory session under way. It goes on after a restart of the service, until somebody ends it."""

    def __init__(self, settings: LaboratorySettings, publisher: Publisher, store: Store) -> None:
        """Read the session that was under way from the index.

        Raises:
            ServiceError: the index is at fault.
        """
        self._settings, self._publisher, self._store = settings, publisher, store
        self._changing = asyncio.Lock()
        self.current: LabSession | None = store.find_lab_session_under_way()

    def begin(self, wanted: LabSessionRequest, by: str | None) -> LabSession:
        """Begin a session, and end the one before.

        Raises:
            ConfigurationError: the subject's code or a field is not what the settings say.
        """
        self._check(wanted)
        self.end(by)
        now = datetime.now(UTC)
        session = LabSession(
            id=f"S{now:%Y%m%d-%H%M%S}-{secrets.token_hex(2)}",
            **{name: getattr(wanted, name) for name in CHANGEABLE},
            began_at=now.isoformat(timespec="seconds"),
            ended_at=None,
            version=1,
            by=by,
        )
        self._publish(session, f"Session {session.id} begun: subject {session.subject}, {session.condition}")
        return session

    def end(self, by: str | None) -> LabSession | None:
        """End the session under way; return it, or None if there is none."""
        if self.current is None:
            return None
        now = datetime.now(UTC).isoformat(timespec="seconds")
        ended = self._make_version(self.current, by, ended_at=now)
        self._publish(ended, f"Session {ended.id} ended")
        return ended

    async def change(self, session_id: str, wanted: LabSessionChange, by: str | None) -> LabSession | None:
        """Change a session; return it, or None if there is none of this id.

        Raises:
            RefusedError: somebody has changed it meanwhile.
            ConfigurationError: the subject's code or a field is not what the settings say.
            ServiceError: the index is at fault.
        """
        self._check(wanted)
        async with self._changing:
            before = await self.find(session_id)
            if before is None:
                return None
            if before.version != wanted.version:
                raise RefusedError(
                    f"{before.by or 'Somebody'} has changed this session meanwhile: it is at version {before.version}. "
                    "Look at it, then try again."
                )
            changed = self._make_version(before, by, **{name: getattr(wanted, name) for name in CHANGEABLE})
            self._publish(changed, f"Session {changed.id} changed: subject {changed.subject}, {changed.condition}")
            return changed

    async def find(self, session_id: str) -> LabSession | None:
        """Return a session of this service or an earlier one.

        Raises:
            ServiceError: the index is at fault.
        """
        if self.current and self.current.id == session_id:
            return self.current
        return await self._publisher.index_writer.query(self._store.get_lab_session, session_id)

    def require_session_under_way(self, kind: ToolKind) -> None:
        """Check that a session is under way where the settings ask for one.

        Raises:
            RefusedError: there is none.
        """
        if self._settings.session_required and kind is not ToolKind.SIMULATED and self.current is None:
            raise RefusedError("No session is under way. Begin one first: who is examined, and under which conditions.")

    def _check(self, wanted: LabSessionRequest) -> None:
        if not re.fullmatch(self._settings.subject_pattern, wanted.subject):
            raise ConfigurationError(
                f"{wanted.subject!r} is no code of a subject: it has to match {self._settings.subject_pattern} "
                "(`subject_pattern` under [laboratory]). Never write a name."
            )
        if unknown := sorted(set(wanted.fields) - set(self._settings.fields)):
            known = ", ".join(self._settings.fields) or "none"
            raise ConfigurationError(f"There is no field {unknown[0]!r}: the settings know {known}.")

    @staticmethod
    def _make_version(before: LabSession, by: str | None, **changes: Any) -> LabSession:
        return before.model_copy(update={**changes, "version": before.version + 1, "by": by, "number": None})

    def _publish(self, session: LabSession, text: str) -> None:
        if session.ended_at is None:
            self.current = session
        elif self.current and self.current.id == session.id:
            self.current = None
        self._publisher.journal.write(JournalKind.SESSION, text, by=session.by, lab_session=session)
        self._publisher.viewer_hub.broadcast(session)
