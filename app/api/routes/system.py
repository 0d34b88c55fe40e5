"""The route that describes the service: versions, machine, configuration."""

import os
import platform
from datetime import date
from importlib.metadata import version

from fastapi import APIRouter

from app import __version__
from app.api.dependencies import ToolServiceDep
from app.host.disk import free_bytes
from app.messages.people import Role
from app.messages.system import System
from app.people.authorization import require_role
from app.stream.descriptions import build_constant_infos, build_force_scale_info

router = APIRouter(prefix="/api", tags=["system"])
VERSIONED_PACKAGES = (
    "fastapi",
    "uvicorn",
    "websockets",
    "numpy",
    "scipy",
    "numba",
    "pydantic",
    "nidaqmx",
    "pyzmq",
    "plotly",
)


@router.get("/system", dependencies=[require_role(Role.VIEWER)])
async def get_system(tool_service: ToolServiceDep) -> System:
    """Return versions, machine, workers, and the configuration in use (read-only)."""
    plan = tool_service.plan
    return System(
        versions={"graspwatch": __version__, "python": platform.python_version()}
        | {package: version(package) for package in VERSIONED_PACKAGES},
        machine=f"{platform.system()} {platform.release()}, {platform.machine()}, {os.cpu_count()} cores",
        started_at=tool_service.started_at,
        workers=tool_service.state.worker_conditions(),
        realtime=tool_service.worker_monitor.realtime,
        data_folder=str(plan.data_folder),
        free_disk_bytes=free_bytes(plan.data_folder),
        tool=plan.tool.model_dump(mode="json"),
        constants=build_constant_infos(plan.tool, date.today()),
        force_scale=build_force_scale_info(plan.tool),
        settings=plan.settings.model_dump(mode="json"),
    )
