"""What a fit leaves in a tool file."""

from datetime import date, timedelta

from acquisition.bench.fits import Fit
from config.schema import Measured


def measured_of(fit: Fit, today: date, person: str, valid_days: int) -> list[Measured]:
    """How each constant came about, and until when it is good."""
    return [
        Measured(
            constant=each.key.partition(".")[2], value=each.value, low=each.low, high=each.high, unit=each.unit,
            residual=each.residual, residual_unit=each.residual_unit, readings=each.readings, date=today, person=person,
            expires=today + timedelta(days=valid_days),
        )
        for each in fit.constants
    ]  # fmt: skip
