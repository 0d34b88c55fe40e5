"""Add tables to the index: ground truth of grasps, marks on recordings, laboratory sessions."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"


def upgrade() -> None:
    op.create_table(
        "truths",
        sa.Column("run_id", sa.String, primary_key=True),
        sa.Column("grasp", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("held", sa.String),
        sa.Column("remark", sa.String),
        sa.Column("version", sa.Integer, nullable=False),
        sa.Column("message", sa.JSON, nullable=False),
    )
    op.create_index("ix_truths_held", "truths", ["held"])
    op.create_table(
        "marks",
        sa.Column("id", sa.String, primary_key=True),
        sa.Column("run_id", sa.String, nullable=False),
        sa.Column("at_s", sa.Double, nullable=False),
        sa.Column("text", sa.String, nullable=False),
        sa.Column("deleted", sa.Boolean, nullable=False),
        sa.Column("version", sa.Integer, nullable=False),
        sa.Column("message", sa.JSON, nullable=False),
    )
    op.create_index("ix_marks_run_id", "marks", ["run_id"])
    op.create_table(
        "lab_sessions",
        sa.Column("id", sa.String, primary_key=True),
        sa.Column("subject", sa.String, nullable=False),
        sa.Column("species", sa.String),
        sa.Column("condition", sa.String, nullable=False),
        sa.Column("began_ms", sa.Double, nullable=False),
        sa.Column("ended_ms", sa.Double),
        sa.Column("version", sa.Integer, nullable=False),
        sa.Column("message", sa.JSON, nullable=False),
    )
    op.create_index("ix_lab_sessions_subject", "lab_sessions", ["subject"])
    op.create_index("ix_lab_sessions_began_ms", "lab_sessions", ["began_ms"])
    op.add_column("runs", sa.Column("session", sa.String))
    op.create_index("ix_runs_session", "runs", ["session"])
