"""How an older index becomes today's; alembic reads this folder. A revision that was released is never changed."""
