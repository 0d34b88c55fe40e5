"""The demonstration of `make run`: a protocol over and over, on each tissue in turn, while nobody else runs one."""

import asyncio
from itertools import cycle

from app.station import Station
from app.wire import Phase
from config.errors import ServiceError
from config.load import load_protocol

PROTOCOL = "trapezoid_2hz"
GRASPS = 2
PAUSE_S = 1.5
AFTER_A_PERSON_S = 20.0  # somebody stopped or started a run: leave the tool to them for a while


async def demonstrate(station: Station) -> None:
    """Run until cancelled."""
    protocol = load_protocol(PROTOCOL)
    own: set[str] = set()
    for tissue in cycle(station.plan.library.tissues):
        await asyncio.sleep(PAUSE_S)
        while station.phase is not Phase.IDLE:
            await asyncio.sleep(PAUSE_S)
        last = next(reversed(station.runs.values()), None)
        if last and (last.id not in own or last.state == "stopped"):
            await asyncio.sleep(AFTER_A_PERSON_S)
        if station.phase is not Phase.IDLE or (last and next(reversed(station.runs.values())) is not last):
            continue
        try:
            own.add((await station.start_run(protocol, GRASPS, tissue)).id)
        except ServiceError:
            continue  # its alarm is on; the next round tries again
