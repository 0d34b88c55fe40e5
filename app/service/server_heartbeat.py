"""The function that sends the server's signs of life to the acquisition."""

import asyncio
import time

import zmq.asyncio

from acquisition import bus
from app.service.metrics import Metrics

HEARTBEAT_PERIOD_S = 0.05
"""A run ends when signs of life stop for `server_silence_s`, which is at least six of these periods."""


async def send_heartbeats(context: zmq.asyncio.Context, address: str, metrics: Metrics) -> None:
    """Send signs of life from the event loop that carries STOP, never from another thread."""
    signs = bus.open_publisher(context, address)
    try:
        while True:
            asked_s = time.monotonic()
            await signs.send(b"")
            await asyncio.sleep(HEARTBEAT_PERIOD_S)
            metrics.server_delay.observe(max(time.monotonic() - asked_s - HEARTBEAT_PERIOD_S, 0.0))
    finally:
        signs.close()
