"""LabVIEW measurement files as other laboratories write them."""

import gzip
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

NAMES = ("Dev1/ai0", "Dev1/ai2", "Dev1/ai3", "Dev1/ai1", "Untitled")  # strain, command, touch 1, touch 2, encoder
SEPARATOR_NAMES = {"\t": "Tab", ",": "Comma", ";": "Semicolon"}
VOLTAGE_UNITS = {"": 1.0, "V": 1.0, "Volts": 1.0, "volt": 1.0, "mV": 1e-3, "µV": 1e-6, "millivolts": 1e-3, "kV": 1e3}
ANGLE_UNITS = {
    "": 1.0,
    "deg": 1.0,
    "Degrees": 1.0,
    "°": 1.0,
    "rad": 180 / math.pi,
    "mrad": 0.18 / math.pi,
    "Radians": 180 / math.pi,
    "rev": 360.0,
}
TIME_UNITS = {"": 1.0, "s": 1.0, "ms": 1e-3, "Seconds": 1.0}


@dataclass(frozen=True)
class Dialect:
    """How a file is written. Units are labels; the numbers are written in them."""

    separator: str = "\t"
    decimal: str = "."
    x_columns: str = "One"
    names: tuple[str, ...] = NAMES
    volts: str = "Volts"
    angle: str = "Degrees"
    time: str = ""
    date: str = "2024/03/05"
    clock: str = "10:11:12.5"
    segments: int = 1
    line_end: str = "\n"
    encoding: str = "utf-8"
    special: bool = False
    comment: str = ""


def made_up_grasp(samples: int = 60) -> np.ndarray:
    """Strain V, command V, touch V, touch V and encoder degrees of a closing tool, shape (samples, 5)."""
    share = np.linspace(0.0, 1.0, samples)
    return np.column_stack([0.82 + 1.3 * share**2, 2 * share, np.zeros(samples), np.ones(samples), 150 * share])


def log_text(samples: np.ndarray, dialect: Dialect, rate_hz: float = 1000.0) -> str:
    """The text of a file in a dialect; `samples` has shape (n, channels)."""
    sep, channels = dialect.separator, len(dialect.names)
    units = [*[dialect.volts] * (channels - 1), dialect.angle]
    factors = [VOLTAGE_UNITS.get(dialect.volts, 1.0)] * (channels - 1) + [ANGLE_UNITS.get(dialect.angle, 1.0)]
    time_factor = TIME_UNITS.get(dialect.time, 1.0)
    wide = sep * (2 if dialect.x_columns == "Multi" else 1)

    def number(value: float) -> str:
        return f"{value:.12g}".replace(".", dialect.decimal)

    def field(name: str, values: list[str]) -> str:
        return name + sep + wide.join(values)

    def segment(first: int, part: np.ndarray) -> list[str]:
        special = ["***Start_Special***", f"Tester{sep}Ada", "***End_Special***"] if dialect.special else []
        head = [
            *special,
            sep,
            f"Channels{sep}{channels}",
            field("Samples", [str(len(part))] * channels),
            field("Date", [dialect.date] * channels),
            field("Time", [dialect.clock] * channels),
            field("Y_Unit_Label", units),
            field("X_Dimension", ["Time"] * channels),
            *([field("X_Unit_Label", [dialect.time] * channels)] if dialect.time else []),
            field("X0", [number(first / rate_hz / time_factor)] * channels),
            field("Delta_X", [number(1 / rate_hz / time_factor)] * channels),
            f"***End_of_Header***{sep}",
        ]
        if dialect.x_columns == "Multi":
            headings = sep.join(f"X_Value{sep}{name}" for name in dialect.names)
        else:
            headings = sep.join(["X_Value", *dialect.names])
        rows = []
        for row, values in enumerate(part, first):
            time, cells = (
                number(row / rate_hz / time_factor),
                [number(v / f) for v, f in zip(values, factors, strict=True)],
            )
            match dialect.x_columns:
                case "Multi":
                    line = sep.join(f"{time}{sep}{cell}" for cell in cells)
                case "No":
                    line = sep + sep.join(cells)
                case _:
                    line = time + sep + sep.join(cells)
            rows.append(line + (sep + dialect.comment if dialect.comment else ""))
        return [*head, f"{headings}{sep}Comment", *rows]

    head = [
        f"LabVIEW Measurement{sep}",
        f"Writer_Version{sep}2",
        f"Separator{sep}{SEPARATOR_NAMES[sep]}",
        f"Decimal_Separator{sep}{dialect.decimal}",
        f"Multi_Headings{sep}{'Yes' if dialect.segments > 1 else 'No'}",
        f"X_Columns{sep}{dialect.x_columns}",
        f"Time_Pref{sep}Relative",
        f"Date{sep}{dialect.date}",
        f"Time{sep}{dialect.clock}",
        f"***End_of_Header***{sep}",
    ]
    body: list[str] = []
    first = 0
    for part in np.array_split(samples, dialect.segments):
        body += segment(first, part)
        first += len(part)
    return dialect.line_end.join([*head, *body]) + dialect.line_end


def write_log(path: Path, samples: np.ndarray | None = None, dialect: Dialect | None = None) -> Path:
    """Write a file in a dialect, packed if its name ends in .gz; return its path."""
    dialect = dialect or Dialect()
    content = log_text(made_up_grasp() if samples is None else samples, dialect).encode(dialect.encoding)
    path.write_bytes(gzip.compress(content) if path.suffix.lower() == ".gz" else content)
    return path
