"""The class ToolDraft: a tool file for a recording or a serial device, from what is known of its columns."""

import math
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from acquisition.recordings.column_survey import (
    IGNORED_AT_LINE_END,
    SurveyedColumn,
    TimeGuess,
    guess_times,
    survey_columns,
)
from acquisition.worker_process import limit_memory
from app.host.background_process import SendMessage
from app.messages.named_files import ColumnSummary, GraspSummary, TimeColumnGuess, ToolDraftReport
from config.errors import ConfigurationError, GraspwatchError
from config.load import parse_file
from config.schema import ConditioningSettings, Tool

PLOT_PARTS = 28
SHOWN_GRASPS = 5

SHUT_M = 0.005
"""Travel of jaws of which nothing is known, from open to shut, m."""
NOISE_SHARE = 0.002
"""Least noise, as a share of the span, of a sensor that seems to have none at rest."""
RISE_SDS, RISE_SHARE = 6.0, 0.02
"""Force that shows contact: standard deviations of its noise, and least share of its span."""
CLOSING_SHARE = 0.25
"""Share of the position's span at which a grasp of a hand-driven tool has begun."""


@dataclass(frozen=True, slots=True)
class ColumnAnswers:
    """What a person says about the columns, which count from 1; 0 or None: not known, or there is none.

    `newton` are the newtons at the jaws for one unit of the force column, `millimetre` is the jaw travel, mm, for one
    unit of the position column. `rate_hz` is needed without times.
    """

    name: str
    force: int | None = None
    position: int | None = None
    command: int | None = None
    newton: float | None = None
    millimetre: float | None = None
    rate_hz: float | None = None
    port: str | None = None

    @property
    def assumed(self) -> list[str]:
        """What a tool file has to assume."""
        return [what for what, value in (("newtons", self.newton), ("millimetres", self.millimetre)) if not value]

    def build_draft(self, columns: Mapping[int, SurveyedColumn], times: TimeGuess | None, source: str) -> "ToolDraft":
        """Return the draft of the tool file; `source` names the recording in errors.

        Raises:
            ConfigurationError: a column holds no numbers, there are neither times nor a rate, or a tool with a motor
                command is to be watched live.
        """
        rate_hz = times.rate_hz if times else self.rate_hz
        if rate_hz is None:
            raise ConfigurationError(f"{source}: no column holds times. Say how many samples a second there are.")
        if self.port and self.command:
            raise ConfigurationError("A tool on a serial port has no motor command. Leave one of the two out.")
        force, position = self.force or 0, self.position or 0
        if force == position:
            raise ConfigurationError(f"{source}: force and position are the same column. Choose another one.")
        there = ", ".join(map(str, columns))
        for number in (force, position, self.command or force):
            if number not in columns:
                raise ConfigurationError(f"{source}: column {number} holds no numbers; there is {there}.")
            if number != self.command and columns[number].span == 0.0:
                raise ConfigurationError(f"{source}: column {number} does not change. Choose another one.")
        return ToolDraft(
            self.name,
            columns[force],
            columns[position],
            rate_hz,
            (times.column, times.unit) if times else None,
            self.command or None,
            self.newton or None,
            1e-3 * self.millimetre if self.millimetre else None,
            self.port or None,
        )


@dataclass(frozen=True, slots=True)
class ToolDraft:
    """What a tool file is made from.

    `newton_per_unit` and `metre_per_unit` convert the force and position columns; None: assumed, and said so in the
    file. `command` is the column of the motor command, V; without it the tool is driven by hand. `port` is the serial
    port of the device that printed the columns, to watch it live.
    """

    name: str
    force: SurveyedColumn
    position: SurveyedColumn
    rate_hz: float
    time: tuple[int, str] | None = None
    command: int | None = None
    newton_per_unit: float | None = None
    metre_per_unit: float | None = None
    port: str | None = None

    def build_text(self, source: str, today: date) -> str:
        """Return the text of the tool file; `source` names the recording.

        Raises:
            ConfigurationError: a value is not plausible; the text names it and the columns that it comes from.
        """
        document = tomlkit.document()
        document.add(tomlkit.comment(f"Made by `graspwatch tool new` from {source}. Correct what is called assumed."))
        for key, value in self._build_content(today).items():
            document.add(key, tomlkit.item(value))
        text = tomlkit.dumps(document)
        try:
            parse_file(text, Tool, f"{self.name}.toml")
        except ConfigurationError as error:
            raise ConfigurationError(
                f"Column {self.force.number} as the force and column {self.position.number} as the position make no "
                f"plausible tool. Choose other columns, or correct the newtons or millimetres of a unit. {error}"
            ) from None
        return text

    def _build_content(self, today: date) -> dict[str, Any]:
        volt_per_unit = self.force.sign * 10.0 ** -math.floor(math.log10(max(self.force.span, 1e-9)))  # 1 to 10 V
        span_v = abs(volt_per_unit) * self.force.span
        noise_v = max(abs(volt_per_unit) * self.force.noise_sd, NOISE_SHARE * span_v)
        newton_per_unit = 1.0 if self.newton_per_unit is None else self.newton_per_unit
        metre_per_unit = SHUT_M / self.position.span if self.metre_per_unit is None else self.metre_per_unit
        table: dict[str, Any] = {"ignore_at_line_end": IGNORED_AT_LINE_END}
        table |= {"time": {"column": self.time[0], "unit": self.time[1]}} if self.time else {"rate_hz": self.rate_hz}
        columns = [
            _describe_column("strain_v", self.force, volt_per_unit),
            _describe_column("encoder_deg", self.position, self.position.sign),
        ]
        if self.command is not None:
            columns.append({"signal": "motor_command_v", "column": self.command, "unit": "V"})
        known = self.newton_per_unit is not None
        content: dict[str, Any] = {
            "name": self.name,
            "title": self.name.replace("_", " ").capitalize(),
            "kind": "serial" if self.port else "recording",
            "board": {"sample_rate_hz": _round(self.rate_hz), "block_samples": 5},
            "table": table | {"columns": columns},
            "kinematics": {
                "kind": "direct",
                "newton_per_volt": _round(newton_per_unit / abs(volt_per_unit)),
                "metre_per_degree": _round(metre_per_unit),
                "opening_m": _round(metre_per_unit * self.position.span),
            },
            "calibration": {
                "rest_offset_v": 0.0,
                "rest_tolerance_v": _round(max(0.05 * span_v, 5 * noise_v)),
                "date": today.isoformat(),
                "person": "tool new",
                "jaw_force_scale": {
                    "value": 1.0,
                    "low": 0.8 if known else 0.1,
                    "high": 1.25 if known else 10.0,
                    "measured": False,
                    "source": "newtons as stated, not measured at the jaws" if known else "assumed: one newton a unit",
                },
            },
            "noise": {"strain_sd_v": _round(noise_v), "strain_lsb_v": _round(abs(volt_per_unit) * self.force.step)},
            "contact": {
                "touch_trusted": False,
                "force_rise_v": _round(max(RISE_SDS * noise_v, RISE_SHARE * span_v)),
                "wall_above_v": _round(0.3 * span_v),
                "wall_span_v": _round(0.15 * span_v),
                "wall_slack_deg_per_volt": max(_round(0.02 * self.position.span / span_v), 0.2),
                "slip_share": 0.5,
                "walk_deg": max(_round(0.5 * self.position.span), 5.0),
            },
        }
        if self.port:
            content["serial"] = {"port": self.port, "baud": 115_200}
        if self.command is None:
            content["hand_driven"] = {"closing_deg": _round(CLOSING_SHARE * self.position.span)}
        return content


def _describe_column(signal: str, column: SurveyedColumn, scale: float) -> dict[str, Any]:
    """Return an entry of [[table.columns]] by which the signal is 0 with open jaws and rises from there."""
    offset = _round(-scale * column.rest)
    return {"signal": signal, "column": column.number, "unit": "", "scale": scale, "offset": offset}


def _round(value: float) -> float:
    return float(f"{value:.4g}")


def compute_part_means(values: np.ndarray, parts: int = PLOT_PARTS) -> np.ndarray:
    """Return the means of equal parts of the values, for a small plot, (parts,) or fewer."""
    return np.array([part.mean() for part in np.array_split(values, min(parts, len(values)))])


def summarize_grasps(recording: Path, tool: Tool, conditioning: ConditioningSettings) -> list[GraspSummary]:
    """Return the grasps that a tool file finds in a recording.

    Raises:
        RecordingError: the file does not fit the tool file.
    """
    from acquisition.recordings.conditioned_blocks import read_conditioned_blocks
    from acquisition.recordings.recording import RecordingSource
    from estimator.learning.recorded_grasps import split_grasps  # slow imports

    blocks = read_conditioned_blocks(RecordingSource(recording, tool), tool, conditioning, lambda share: None)
    rate_hz = tool.board.sample_rate_hz
    return [
        GraspSummary(
            number=number,
            start_s=float(each["tick"][0] / rate_hz),
            duration_s=len(each) / rate_hz,
            peak_force_n=float(np.nanmax(each["jaw_force_n"])),
            travel_m=float(np.nanmax(each["jaw_displacement_m"])),
            has_contact=bool(each["contact_tick"][-1] >= 0),
        )
        for number, each in split_grasps(np.concatenate([block.samples for block in blocks]))
    ]


# --- in the background process ------------------------------------------------------------------------------------


def send_draft_report(
    send: SendMessage, content: bytes, file_name: str, answers: ColumnAnswers, conditioning: ConditioningSettings
) -> None:
    """Survey a recording's content, draft a tool file if its columns are named, and send the report.

    Raises:
        RecordingError: the file cannot be read.
        ConfigurationError: the answers do not fit the file.
    """
    limit_memory()  # a packed file may be large
    with tempfile.TemporaryDirectory(prefix="graspwatch-draft-") as folder:
        recording = Path(folder) / Path(file_name).name
        recording.write_bytes(content)
        try:
            send(_build_report(recording, answers, conditioning))
        except GraspwatchError as error:
            raise type(error)(str(error).replace(f"{folder}/", "")) from None


def _build_report(recording: Path, answers: ColumnAnswers, conditioning: ConditioningSettings) -> ToolDraftReport:
    columns = {column.number: column for column in survey_columns(recording)}
    times = guess_times(list(columns.values()))
    text, grasps = None, []
    if answers.force and answers.position:
        text = answers.build_draft(columns, times, recording.name).build_text(recording.name, date.today())
        grasps = summarize_grasps(recording, parse_file(text, Tool, f"{answers.name}.toml"), conditioning)
    return ToolDraftReport(
        columns=[
            ColumnSummary(
                number=column.number,
                name=column.name,
                low=float(column.values.min()),
                high=float(column.values.max()),
                means=compute_part_means(column.values).tolist(),
            )
            for column in columns.values()
        ],
        times=TimeColumnGuess(column=times.column, unit=times.unit, rate_hz=times.rate_hz) if times else None,
        text=text,
        assumed=answers.assumed if text else [],
        grasps=len(grasps),
        first_grasps=grasps[:SHOWN_GRASPS],
    )
