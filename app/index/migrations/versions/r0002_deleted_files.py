"""Add columns to the index: who deleted a recording and when, and whether the limiter held a grasp back."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"


def upgrade() -> None:
    op.add_column("files", sa.Column("deleted_ms", sa.Double))
    op.add_column("files", sa.Column("deleted_by", sa.String))
    with op.batch_alter_table("grasps") as grasps:
        grasps.add_column(sa.Column("held_back", sa.Boolean, nullable=False, server_default=sa.false()))
    table = sa.table(
        "grasps",
        sa.column("run_id", sa.String),
        sa.column("index", sa.Integer),
        sa.column("held_back", sa.Boolean),
        sa.column("message", sa.JSON),
    )
    connection = op.get_bind()
    for run_id, index, message in connection.execute(sa.select(table.c.run_id, table.c.index, table.c.message)).all():
        if message["grasp"]["held_back"]:
            this = (table.c.run_id == run_id) & (table.c.index == index)
            connection.execute(table.update().where(this).values(held_back=True))
    with op.batch_alter_table("grasps") as grasps:
        grasps.alter_column("held_back", server_default=None)
