"""Create the index's tables of runs, grasps, alarms, journal lines and files."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None


def upgrade() -> None:
    op.create_table(
        "runs",
        sa.Column("id", sa.String, primary_key=True),
        sa.Column("protocol", sa.String),
        sa.Column("tissue", sa.String),
        sa.Column("by", sa.String),
        sa.Column("state", sa.String),
        sa.Column("started_ms", sa.Double),
        sa.Column("ended_ms", sa.Double),
        sa.Column("why", sa.String),
        sa.Column("grasps", sa.Integer, nullable=False),
        sa.Column("message", sa.JSON),
    )
    op.create_index("runs_by_start", "runs", ["started_ms", "id"])
    op.create_index("ix_runs_protocol", "runs", ["protocol"])
    op.create_index("ix_runs_tissue", "runs", ["tissue"])
    op.create_index("ix_runs_state", "runs", ["state"])
    op.create_table(
        "grasps",
        sa.Column("run_id", sa.String, sa.ForeignKey("runs.id"), primary_key=True),
        sa.Column("index", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("label", sa.String, nullable=False),
        sa.Column("probability", sa.Double),
        sa.Column("peak_force_n", sa.Double),
        sa.Column("valid", sa.Boolean, nullable=False),
        sa.Column("message", sa.JSON, nullable=False),
    )
    op.create_index("grasps_by_label", "grasps", ["label", "valid"])
    op.create_table(
        "alarms",
        sa.Column("key", sa.String, primary_key=True),
        sa.Column("kind", sa.String, nullable=False),
        sa.Column("priority", sa.String, nullable=False),
        sa.Column("active", sa.Boolean, nullable=False),
        sa.Column("text", sa.String, nullable=False),
        sa.Column("began_ms", sa.Double, nullable=False),
        sa.Column("ended_ms", sa.Double),
        sa.Column("acknowledged_by", sa.String),
        sa.Column("change", sa.Integer, nullable=False),
        sa.Column("message", sa.JSON, nullable=False),
    )
    op.create_index("ix_alarms_kind", "alarms", ["kind"])
    op.create_index("ix_alarms_began_ms", "alarms", ["began_ms"])
    op.create_table(
        "audit",
        sa.Column("key", sa.String(64), primary_key=True),
        sa.Column("at_ms", sa.Double, nullable=False),
        sa.Column("kind", sa.String, nullable=False),
        sa.Column("text", sa.String, nullable=False),
        sa.Column("by", sa.String),
        sa.Column("message", sa.JSON, nullable=False),
    )
    op.create_index("audit_by_time", "audit", ["at_ms", "key"])
    op.create_index("ix_audit_kind", "audit", ["kind"])
    op.create_index("ix_audit_by", "audit", ["by"])
    op.create_table(
        "files",
        sa.Column("name", sa.String, primary_key=True),
        sa.Column("run_id", sa.String),
        sa.Column("size_bytes", sa.BigInteger, nullable=False),
        sa.Column("made_ms", sa.Double, nullable=False),
        sa.Column("duration_s", sa.Double),
        sa.Column("samples", sa.BigInteger),
        sa.Column("lost_samples", sa.BigInteger),
        sa.Column("condition", sa.String),
        sa.Column("message", sa.JSON, nullable=False),
    )
    op.create_index("ix_files_run_id", "files", ["run_id"])
    op.create_index("ix_files_made_ms", "files", ["made_ms"])
