"""Functions that build descriptions of the tool, its library and protocols for viewers."""

from datetime import date

import numpy as np

from acquisition.protocol_player import build_cycle_command
from app import __version__
from app.host.clock import now_ms
from app.messages.live import Hello
from app.messages.tool import (
    ConstantInfo,
    ForceScaleInfo,
    HoldableInfo,
    LibraryInfo,
    ProtocolInfo,
    SpreadInfo,
    TissueInfo,
    ToolInfo,
)
from app.stream.frames import build_channels
from config.errors import RefusedError
from config.load import build_graspable_library
from config.schema import GraspProtocol, TissueLibrary, Tool, ToolKind
from config.service_plan import ServicePlan

MAX_PREVIEW_POINTS = 200


def build_hello(plan: ServicePlan, tool: Tool, *, recording: bool = False) -> Hello:
    """Return the first message to a viewer of `tool`, or of a recording of it."""
    library, shares = plan.library, plan.settings.warnings
    return Hello(
        version=__version__,
        server_time_ms=now_ms(),
        tool=build_tool_info(tool, recording=recording),
        library=build_library_info(library),
        holdable=_build_holdable_infos(library) if tool.kind is ToolKind.SIMULATED and not recording else [],
        lowest_threshold_n=min(library.convert_thresholds_to_displayed_n(tool).values()),
        decide_at=plan.settings.identification.decide_at,
        lab_fields=list(plan.settings.laboratory.fields),
        warning_shares=[shares.low, shares.medium, shares.high],
        channels=build_channels(list(library.tissues)),
        frame_rate_hz=plan.settings.server.frame_rate_hz,
    )


def _build_holdable_infos(library: TissueLibrary) -> list[HoldableInfo]:
    return [
        HoldableInfo(name=name, title=profile.title, in_library=name in library.tissues)
        for name, profile in build_graspable_library(library).tissues.items()
    ]


def build_tool_info(tool: Tool, *, recording: bool = False) -> ToolInfo:
    return ToolInfo(
        name=tool.name,
        title=tool.title,
        kind=ToolKind.RECORDING if recording else tool.kind,
        has_motor=tool.has_motor and not recording,
        sample_rate_hz=tool.board.sample_rate_hz,
        max_command_v=tool.limits.max_command_v,
        force_ceiling_n=tool.limits.force_ceiling_n,
        force_scale=build_force_scale_info(tool),
        calibration_date=tool.calibration.date,
        calibrated_by=tool.calibration.person,
    )


def build_force_scale_info(tool: Tool) -> ForceScaleInfo:
    scale = tool.calibration.jaw_force_scale
    return ForceScaleInfo(**scale.model_dump(mode="json"), text=tool.scale_text)


def build_constant_infos(tool: Tool, today: date) -> list[ConstantInfo]:
    return [
        ConstantInfo(
            constant=each.constant,
            value=each.value,
            date=each.date,
            by=each.person,
            expires=each.expires.isoformat() if each.expires else None,
            expired=each.is_expired(today),
        )
        for each in tool.constant_origins
    ]


def build_protocol_info(protocol: GraspProtocol, tool: Tool) -> ProtocolInfo:
    """Return a protocol's description with its motor command on `tool`, or with the reason why this tool refuses it."""
    refused, command = None, np.zeros(0)
    try:
        command = build_cycle_command(protocol, tool)
    except RefusedError as error:
        refused = str(error)
    thin = max(len(command) // MAX_PREVIEW_POINTS, 1)
    return ProtocolInfo(
        name=protocol.name,
        title=protocol.title,
        cycles=protocol.cycles,
        cycle_s=protocol.waveform.cycle_s,
        peak_command_v=float(command.max(initial=0.0)),
        refused=refused,
        time_s=[i / tool.board.sample_rate_hz for i in range(0, len(command), thin)],
        command_v=command[::thin].tolist(),
    )


def build_library_info(library: TissueLibrary) -> LibraryInfo:
    tissues = [
        TissueInfo(
            name=name,
            title=profile.title,
            alpha_n=library.compute_apparent_alpha(name).median_n,
            beta_per_m=profile.beta_per_m,
            damping_kg_per_s=profile.damping_kg_per_s,
            thickness_m=profile.thickness_m,
            threshold_n=library.threshold_n(name),
            threshold_pa=profile.threshold_pa,
            spread=SpreadInfo(
                **library.spread_of(name).model_dump() | {"log_alpha": library.compute_apparent_alpha(name).log_sd}
            ),
        )
        for name, profile in library.tissues.items()
    ]
    return LibraryInfo(
        name=library.name,
        title=library.title,
        source=library.source,
        mass_kg=library.mass_kg,
        jaw_area_m2=library.jaw_area_m2,
        tissues=tissues,
    )
