"""The index's tables: columns for searching and sorting, and the whole message as JSON.

Times are milliseconds since 1970. `message` is the record (`app/messages/stored.py`); a run known only by its grasps
has none.
"""

from typing import Any

from sqlalchemy import JSON, BigInteger, Double, ForeignKey, Index, String
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column


class IndexTable(DeclarativeBase):
    type_annotation_map = {float: Double, dict[str, Any]: JSON(none_as_null=True), str: String}  # noqa: RUF012


class RunRow(IndexTable):
    __tablename__ = "runs"
    __table_args__ = (Index("runs_by_start", "started_ms", "id"),)

    id: Mapped[str] = mapped_column(primary_key=True)
    protocol: Mapped[str | None] = mapped_column(index=True)
    tissue: Mapped[str | None] = mapped_column(index=True)
    by: Mapped[str | None]
    state: Mapped[str | None] = mapped_column(index=True)
    started_ms: Mapped[float | None]
    ended_ms: Mapped[float | None]
    why: Mapped[str | None]
    grasps: Mapped[int] = mapped_column(default=0)
    session: Mapped[str | None] = mapped_column(index=True)
    message: Mapped[dict[str, Any] | None]


class GraspRow(IndexTable):
    __tablename__ = "grasps"
    __table_args__ = (Index("grasps_by_label", "label", "valid"),)

    run_id: Mapped[str] = mapped_column(ForeignKey("runs.id"), primary_key=True)
    index: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    label: Mapped[str]
    probability: Mapped[float | None]
    peak_force_n: Mapped[float | None]
    valid: Mapped[bool]
    held_back: Mapped[bool]
    message: Mapped[dict[str, Any]]


class TruthRow(IndexTable):
    """The newest ground truth of a grasp. The index may not know its run."""

    __tablename__ = "truths"

    run_id: Mapped[str] = mapped_column(primary_key=True)
    grasp: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    held: Mapped[str | None] = mapped_column(index=True)
    remark: Mapped[str | None]
    version: Mapped[int]
    message: Mapped[dict[str, Any]]


class MarkRow(IndexTable):
    """A mark in its newest version. The index may not know its run."""

    __tablename__ = "marks"

    id: Mapped[str] = mapped_column(primary_key=True)
    run_id: Mapped[str] = mapped_column(index=True)
    at_s: Mapped[float]
    text: Mapped[str]
    deleted: Mapped[bool]
    version: Mapped[int]
    message: Mapped[dict[str, Any]]


class LabSessionRow(IndexTable):
    """A laboratory session in its newest version."""

    __tablename__ = "lab_sessions"

    id: Mapped[str] = mapped_column(primary_key=True)
    subject: Mapped[str] = mapped_column(index=True)
    species: Mapped[str | None]
    condition: Mapped[str]
    began_ms: Mapped[float] = mapped_column(index=True)
    ended_ms: Mapped[float | None]
    version: Mapped[int]
    message: Mapped[dict[str, Any]]


class AlarmRow(IndexTable):
    """`key`: the alarm's id and start, because ids begin anew with each service."""

    __tablename__ = "alarms"

    key: Mapped[str] = mapped_column(primary_key=True)
    kind: Mapped[str] = mapped_column(index=True)
    priority: Mapped[str]
    active: Mapped[bool]
    text: Mapped[str]
    began_ms: Mapped[float] = mapped_column(index=True)
    ended_ms: Mapped[float | None]
    acknowledged_by: Mapped[str | None]
    change: Mapped[int]
    message: Mapped[dict[str, Any]]


class AuditRow(IndexTable):
    """A line of the journal. `key` is the digest of its content, which identifies it: lines never change."""

    __tablename__ = "audit"
    __table_args__ = (Index("audit_by_time", "at_ms", "key"),)

    key: Mapped[str] = mapped_column(String(64), primary_key=True)
    at_ms: Mapped[float]
    kind: Mapped[str] = mapped_column(index=True)
    text: Mapped[str]
    by: Mapped[str | None] = mapped_column(index=True)
    message: Mapped[dict[str, Any]]


class FileRow(IndexTable):
    """A recording; a deleted one stays, with the time and the person. The index may not know its run."""

    __tablename__ = "files"

    name: Mapped[str] = mapped_column(primary_key=True)
    run_id: Mapped[str | None] = mapped_column(index=True)
    size_bytes: Mapped[int] = mapped_column(BigInteger)
    made_ms: Mapped[float] = mapped_column(index=True)
    duration_s: Mapped[float | None]
    samples: Mapped[int | None] = mapped_column(BigInteger)
    lost_samples: Mapped[int | None] = mapped_column(BigInteger)
    condition: Mapped[str | None]
    deleted_ms: Mapped[float | None]
    deleted_by: Mapped[str | None]
    message: Mapped[dict[str, Any]]
