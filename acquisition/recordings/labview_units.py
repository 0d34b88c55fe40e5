"""The function that finds the factor from a unit in LabVIEW's labels to volts, degrees or seconds."""

import math
import re

_PREFIXES = {"": 1.0, "n": 1e-9, "u": 1e-6, "m": 1e-3, "k": 1e3}
_PREFIX_WORDS = {"": 1.0, "nano": 1e-9, "micro": 1e-6, "milli": 1e-3, "kilo": 1e3}
_MICRO_SIGNS = str.maketrans({"\u00b5": "u", "\u03bc": "u"})

VOLT, DEGREE, SECOND = "V", "deg", "s"

# unit -> symbols, which take a prefix and whose case counts, and words, whose case does not
_SPELLINGS: dict[str, tuple[dict[str, float], dict[str, float]]] = {
    VOLT: ({"V": 1.0}, {"volt": 1.0, "volts": 1.0, "v": 1.0}),
    DEGREE: (
        {"rad": math.degrees(1.0), "deg": 1.0, "\u00b0": 1.0},
        {
            "deg": 1.0,
            "degs": 1.0,
            "degree": 1.0,
            "degrees": 1.0,
            "rad": math.degrees(1.0),
            "rads": math.degrees(1.0),
            "radian": math.degrees(1.0),
            "radians": math.degrees(1.0),
            "rev": 360.0,
            "revs": 360.0,
            "revolution": 360.0,
            "revolutions": 360.0,
            "turn": 360.0,
            "turns": 360.0,
        },
    ),
    SECOND: ({"s": 1.0}, {"s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0}),
}


def find_factor(label: str, unit: str) -> float | None:
    """Return the factor from a labelled unit to `unit` (VOLT, DEGREE or SECOND), or None for any other quantity.

    Symbols may have an SI prefix (`mV`, `krad`), words one in full (`millivolts`). Brackets around the label and a
    label that is empty change nothing: without a label, the value is in `unit`.
    """
    text = label.strip().strip("[]()").strip().translate(_MICRO_SIGNS)
    if not text:
        return 1.0
    symbols, words = _SPELLINGS[unit]
    for symbol, factor in symbols.items():
        prefix = text.removesuffix(symbol) if text.endswith(symbol) else None
        if prefix is not None and prefix in _PREFIXES:
            return _PREFIXES[prefix] * factor
    match = re.fullmatch(f"({'|'.join(_PREFIX_WORDS)})({'|'.join(words)})", text.casefold())
    if match is None:
        return None
    prefix, word = match.groups()
    if prefix and len(word) == 1:  # `milliv` is no word
        return None
    return _PREFIX_WORDS[prefix] * words[word]
