"""The function that writes a tool file with newly fitted constants."""

from datetime import date, timedelta
from pathlib import Path

from acquisition.bench.fits import FORCE_SCALE_UNITS, CalibrationFit
from config.schema import FORCE_SCALE_KEY, ConstantMeasurement, ForceScale
from config.writing import write_calibrated_tool


def write_calibration_file(fit: CalibrationFit, tool: str, person: str, valid_days: int, folder: Path) -> Path:
    """Write a copy of `tool` (a name or a path) with today's fitted constants and their origin; return its path.

    Raises:
        ConfigurationError: the folder cannot be written to, or the outcome is no valid tool file.
    """
    today = date.today()
    expires = today + timedelta(days=valid_days)
    values: dict[str, float | ForceScale] = {each.key: each.value for each in fit.constants}
    for each in fit.constants:
        if each.key == f"calibration.{FORCE_SCALE_KEY}":
            values[each.key] = ForceScale(
                law=next(law for law, unit in FORCE_SCALE_UNITS.items() if unit == each.unit),
                value=each.value,
                low=each.low,
                high=each.high,
                measured=True,
                source=f"load cell between the jaws, {each.readings} readings by {person}",
                date=today,
                expires=expires,
            )
    measured = [
        ConstantMeasurement(
            constant=each.key.partition(".")[2],
            value=each.value,
            low=each.low,
            high=each.high,
            unit=each.unit,
            residual=each.residual,
            residual_unit=each.residual_unit,
            readings=each.readings,
            date=today,
            person=person,
            expires=expires,
        )
        for each in fit.constants
        if not isinstance(values[each.key], ForceScale)
    ]
    return write_calibrated_tool(tool, values, measured, today, folder)
