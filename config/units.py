"""Functions that convert units by their names, such as `mV`, `rad` or `ms`.

The registry of units takes a second to load, so it is loaded when the first unit is converted.
"""

import functools
from typing import Any


@functools.cache
def _load_registry() -> Any:
    import pint

    registry = pint.UnitRegistry()
    registry.define("@alias turn = rev")
    return registry


@functools.cache
def _find_base(unit: str) -> tuple[float, Any]:
    """Return the factor from a unit to its base units, and these.

    Raises:
        ValueError: it is no known unit.
    """
    try:
        factor, base = _load_registry().get_base_units(unit)
    except Exception:  # noqa: BLE001 - the parser of units raises AssertionError and others for texts that are none
        raise ValueError(f"{unit!r} is no known unit; write it as in V, mV, deg, rad, rev, s, ms or us") from None
    return float(factor), base


def check_unit(unit: str) -> str:
    """Return the unit unchanged if it is known, or empty.

    Raises:
        ValueError: it is no known unit.
    """
    if unit:
        _find_base(unit)
    return unit


def find_conversion_factor(unit: str, target: str) -> float:
    """Return the factor from one unit to another of the same quantity.

    An angle, a count and a percentage are not the same quantity, although none of them has a dimension.

    Raises:
        ValueError: a unit is not known, or the two do not fit.
    """
    (factor, base), (target_factor, target_base) = _find_base(unit), _find_base(target)
    if base != target_base:
        raise ValueError(f"{unit!r} cannot be converted to {target!r}")
    return factor / target_factor
