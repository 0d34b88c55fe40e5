"""The class TaskWatch, which watches the server's own tasks: none may end unnoticed."""

import asyncio
import logging
from collections.abc import Coroutine

from acquisition import bus
from app.service.commander import Commander
from app.stream.alarms import AlarmManager
from estimator.force_alarms import Priority


class TaskWatch:
    """Watch that brings the motor to zero, raises an alarm and reports the service as faulted when a task fails."""

    def __init__(self, commander: Commander, alarms: AlarmManager) -> None:
        self._commander, self._alarms = commander, alarms
        self._tasks: list[asyncio.Task[None]] = []
        self.internal_error: str | None = None

    def start(self, work: Coroutine[None, None, None]) -> None:
        """Start a task that lives until `aclose`."""
        task = asyncio.create_task(work)
        self.watch(task)
        self._tasks.append(task)

    def watch(self, task: asyncio.Task[None]) -> None:
        """Watch a task that another part started."""
        task.add_done_callback(self._on_end)

    def _on_end(self, task: asyncio.Task[None]) -> None:
        if task.cancelled() or not task.exception():
            return
        self.internal_error = f"The server failed inside ({task.exception()!r}). Start the service again."
        logging.getLogger("graspwatch").error("the server failed inside", exc_info=task.exception())
        self._alarms.raise_technical("server", Priority.HIGH, self.internal_error)
        self._stop_task = asyncio.create_task(self._commander.send(bus.StopCommand("the server failed")))

    async def aclose(self) -> None:
        """Cancel the tasks and wait for their end."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
