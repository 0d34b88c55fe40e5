"""The function that plays the demonstration of `make run`: each tissue, an unknown one and too strong a grasp."""

import asyncio
from dataclasses import dataclass
from itertools import cycle

from app.messages.live import Phase
from app.service.tool_service import ToolService
from config.errors import GraspwatchError
from config.load import load_grasp_protocol
from config.schema import TissueLibrary

NORMAL_PROTOCOL, STRONG_PROTOCOL = "trapezoid_2hz", "strong_2hz"
GRASPS_PER_SCENE = 3  # a spot becomes sure with its second and third grasp
OUT_OF_LIBRARY_TISSUE = "fibrotic_liver"
PAUSE_S = 1.5


@dataclass(frozen=True, slots=True)
class DemoScene:
    tissue: str
    protocol: str
    text: str


def build_scenes(library: TissueLibrary) -> list[DemoScene]:
    """Return the scenes of one round, in order."""
    named = [
        DemoScene(name, NORMAL_PROTOCOL, f"A grasp of {profile.title.lower()}: the answer should be its name")
        for name, profile in library.tissues.items()
    ]
    weakest = min(library.tissues, key=library.threshold_n)
    title = library.tissues[weakest].title.lower()
    strong = f"Too strong a grasp of {title}: the limiter holds the motor back before the tissue is hurt"
    return [
        *named,
        DemoScene(
            OUT_OF_LIBRARY_TISSUE,
            NORMAL_PROTOCOL,
            "A liver six times as stiff as any in the library: the answer should be Unknown",
        ),
        DemoScene(weakest, STRONG_PROTOCOL, strong),
    ]


async def play_demonstration(tool_service: ToolService) -> None:
    """Play the scenes in turn until a person takes over, a run fails or the task is canceled."""
    for scene in cycle(build_scenes(tool_service.plan.library)):
        await asyncio.sleep(PAUSE_S)
        while tool_service.runs.demo_text and tool_service.state.phase is not Phase.IDLE:
            await asyncio.sleep(0.1)
        if not tool_service.runs.demo_text:
            return
        tool_service.runs.demo_text = scene.text
        try:
            await tool_service.run_controller.start(
                load_grasp_protocol(scene.protocol), GRASPS_PER_SCENE, scene.tissue, by=None
            )
        except GraspwatchError:
            continue  # its alarm is on; the next scene is tried
