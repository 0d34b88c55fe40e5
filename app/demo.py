"""The demonstration of `make run`: each tissue, an unknown one, too strong a grasp, until somebody takes over."""

import asyncio
from dataclasses import dataclass
from itertools import cycle

from app.station import Station
from app.wire import Phase
from config.errors import GraspwatchError
from config.load import load_protocol
from config.schema import TissueLibrary

PROTOCOL, STRONG = "trapezoid_2hz", "strong_2hz"
GRASPS = 2
STRANGER = "fibrotic_liver"
PAUSE_S = 1.5


@dataclass(frozen=True, slots=True)
class Scene:
    tissue: str
    protocol: str
    text: str


def scenes(library: TissueLibrary) -> list[Scene]:
    """What is shown, in turn."""
    named = [
        Scene(name, PROTOCOL, f"A grasp of {profile.title.lower()}: the answer should be its name")
        for name, profile in library.tissues.items()
    ]
    weakest = min(library.tissues, key=library.threshold_n)
    title = library.tissues[weakest].title.lower()
    strong = f"Too strong a grasp of {title}: the limiter holds the motor back before the tissue is hurt"
    return [
        *named,
        Scene(STRANGER, PROTOCOL, "A liver six times as stiff as any in the library: the answer should be Unknown"),
        Scene(weakest, STRONG, strong),
    ]


async def demonstrate(station: Station) -> None:
    """Run until a person takes over, a run fails, or it is cancelled."""
    for scene in cycle(scenes(station.plan.library)):
        await asyncio.sleep(PAUSE_S)
        while station.demo and station.phase is not Phase.IDLE:
            await asyncio.sleep(0.1)
        if not station.demo:
            return
        station.demo = scene.text
        try:
            await station.start_run(load_protocol(scene.protocol), GRASPS, scene.tissue, by=None)
        except GraspwatchError:
            continue  # its alarm is on; the next round tries again
