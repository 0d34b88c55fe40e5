"""Signals for tests: protocols played through the simulated grasper, and LabVIEW files in the lab's format."""

import gzip
from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from acquisition.drivers.source import RawBlock
from acquisition.protocol_player import ProtocolPlayer
from acquisition.signal_table import SENSOR_SIGNALS
from acquisition.simulation.grasper import SimulatedGrasper, collect_block
from config.load import load_grasp_protocol, load_library, load_tool
from config.schema import GraspProtocol, Tool

SIGNALS = ("strain_v", "encoder_deg", "motor_command_v", "touch_1_v", "touch_2_v")  # of every tool
LVM_COLUMNS = ("Dev1/ai0", "Dev1/ai2", "Dev1/ai3", "Dev1/ai1", "Untitled")


def simulate_raw(
    tissue: str,
    protocol: str | GraspProtocol = "trapezoid_2hz",
    seed: int = 0,
    cycles: int = 1,
    tool: Tool | None = None,
    empty: bool = False,
) -> list[RawBlock]:
    """Return the raw blocks of a protocol on specimens of `tissue`, or with empty jaws, including the last rest."""
    tool = tool or load_tool("simulated")
    played = load_grasp_protocol(protocol) if isinstance(protocol, str) else protocol
    player = ProtocolPlayer(played, tool, cycles)
    commands = []
    while not player.done:
        commands += [player.next_command(tool.board.block_samples)] * tool.board.block_samples
    grasper = SimulatedGrasper(tool, load_library("porcine"), tissue, seed)
    grasper.gauge_m = 0.0 if empty else None
    return cut(drive(grasper, commands), range(0, len(commands), tool.board.block_samples))


def simulated_recording_tool() -> Tool:
    """Return the simulated tool with the newtons of `smart_tool_2013`, which reads LabVIEW recordings."""
    simulated, scale = load_tool("simulated"), load_tool("smart_tool_2013").calibration.jaw_force_scale
    calibration = simulated.calibration.model_copy(update={"jaw_force_scale": scale})
    return simulated.model_copy(update={"calibration": calibration})


class WatchedGrasper(SimulatedGrasper):
    """A simulated grasper that keeps the true jaw force of every sample, N."""

    def __init__(self, *args, **options) -> None:
        super().__init__(*args, **options)
        self.forces_n: list[float] = []

    def step(self, command_v: float) -> dict[str, float]:
        result = super().step(command_v)
        self.forces_n.append(self.force_n)
        return result


def drive(grasper: SimulatedGrasper, commands_v: Iterable[float]) -> RawBlock:
    """Return one block with a sample for each command; the read-back has no noise."""
    commands = [float(command) for command in commands_v]
    return collect_block([grasper.step(command) for command in commands], commands, first_tick=0)


def raw_block(strain_v, encoder_deg=0.0, motor_command_v=0.0, touch_1_v=0.0, touch_2_v=0.0) -> RawBlock:
    """Return a block that begins at tick 0; a number becomes a constant signal."""
    given = np.broadcast_arrays(strain_v, encoder_deg, motor_command_v, touch_1_v, touch_2_v)
    signals = {name: np.array(signal, float) for name, signal in zip(SIGNALS, given, strict=True)}
    return RawBlock(0, 0, {each.name: np.full(given[0].shape, np.nan) for each in SENSOR_SIGNALS} | signals)


def with_signals(raw: RawBlock, **signals: np.ndarray) -> RawBlock:
    """Return the block with other signals, by name."""
    return replace(raw, signals={**raw.signals, **signals})


def joined(blocks: Iterable[RawBlock]) -> RawBlock:
    """Join consecutive blocks into one."""
    blocks = list(blocks)
    return RawBlock(
        blocks[0].first_tick,
        blocks[0].t_mono_ns,
        {name: np.concatenate([block.signals[name] for block in blocks]) for name in blocks[0].signals},
    )


def cut(raw: RawBlock, at: Iterable[int]) -> list[RawBlock]:
    """Cut a block before the given indices."""
    edges = [0, *sorted(index for index in {*at} if 0 < index < len(raw)), len(raw)]
    return [
        RawBlock(raw.first_tick + begin, 0, {name: values[begin:end] for name, values in raw.signals.items()})
        for begin, end in pairwise(edges)
    ]


def lvm_text(raw: RawBlock, columns: tuple[str, ...] = LVM_COLUMNS) -> str:
    """Format samples as the lab's LabVIEW program logs them: two headers, then tab-separated columns."""
    n, per_channel = len(columns), "\t" * len(columns)
    stamp, date = "10:00:00.0000000000000000000", "2026/11/22"

    def each(name: str, value: str) -> str:
        return f"{name}\t" + f"{value}\t" * n

    head = [
        "LabVIEW Measurement\t",
        "Writer_Version\t2",
        "Reader_Version\t2",
        "Separator\tTab",
        "Decimal_Separator\t.",
        "Multi_Headings\tNo",
        "X_Columns\tOne",
        "Time_Pref\tAbsolute",
        "Operator\ttest",
        f"Date\t{date}",
        f"Time\t{stamp}",
        "***End_of_Header***\t",
        "\t",
        f"Notes\tsimulated{per_channel}",
        f"Channels\t{n}{per_channel}",
        each("Samples", "1000"),
        each("Date", date),
        each("Time", stamp),
        "Y_Unit_Label\t" + "".join("\t" if name == LVM_COLUMNS[-1] else "Volts\t" for name in columns),
        each("X_Dimension", "Time"),
        each("X0", "0.0000000000000000E+0"),
        each("Delta_X", "0.001000"),
        f"***End_of_Header***\t{per_channel}",
        "\t".join(["X_Value", *columns, "Comment"]),
    ]
    signal_of = dict(
        zip(LVM_COLUMNS, ("strain_v", "motor_command_v", "touch_1_v", "touch_2_v", "encoder_deg"), strict=True)
    )
    time_s = (raw.first_tick + np.arange(len(raw))) / 1000.0
    table = np.column_stack([time_s, *(raw.signals[signal_of[column]] for column in columns)])
    return "\n".join([*head, *("\t".join(f"{value:.6f}" for value in row) for row in table)]) + "\n"


def write_lvm(path: Path, raw: RawBlock) -> Path:
    """Write the samples as a LabVIEW recording, compressed if the path ends in `.gz`; return the path."""
    content = lvm_text(raw).encode()
    path.write_bytes(gzip.compress(content) if path.suffix == ".gz" else content)
    return path
