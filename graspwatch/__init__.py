"""The Python client of a Graspwatch service, for programs that watch, start and stop a tool.

    async with Graspwatch("http://localhost:8000") as tool:
        async for estimate in tool.live():
            print(estimate.label, estimate.probability, estimate.force_n)

Research instrument, not a medical device.
"""

from graspwatch.client import Graspwatch
from graspwatch.errors import ClientError, ConnectionLostError, RefusedError, UnreachableError
from graspwatch.frames import Frame

__all__ = ["ClientError", "ConnectionLostError", "Frame", "Graspwatch", "RefusedError", "UnreachableError"]
