"""The demonstration of `make run`: a protocol again and again, each tissue in turn, until somebody takes over."""

import asyncio
from itertools import cycle

from app.station import Station
from app.wire import Phase
from config.errors import ServiceError
from config.load import load_protocol

PROTOCOL = "trapezoid_2hz"
GRASPS = 2
PAUSE_S = 1.5


async def demonstrate(station: Station) -> None:
    """Run until a person takes over, a run fails, or it is cancelled."""
    protocol = load_protocol(PROTOCOL)
    for tissue in cycle(station.plan.library.tissues):
        await asyncio.sleep(PAUSE_S)
        while station.demonstrating and station.phase is not Phase.IDLE:
            await asyncio.sleep(0.1)
        if not station.demonstrating:
            return
        try:
            await station.start_run(protocol, GRASPS, tissue)
        except ServiceError:
            continue  # its alarm is on; the next round tries again
