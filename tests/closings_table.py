"""A recording of closings by hand: a table with a column of words and one of zeros."""

import csv
from pathlib import Path

import numpy as np

RATE_HZ, CLOSINGS, PEAK_UNITS, SHUT_UNITS = 500.0, 6, 300.0, 40.0


def write_closings_table(path: Path) -> Path:
    """Write opening that falls while the jaws close (column 3), force (4) and time in ms (1)."""
    t = np.arange(0.0, 2.0 * (CLOSINGS + 1), 1 / RATE_HZ)
    closing = np.where(t < 2.0, 0.0, np.clip(1.5 * np.sin(np.pi * t) ** 2, 0.0, 1.0) * (np.floor(t) % 2 == 0))
    random = np.random.default_rng(1)
    force = PEAK_UNITS * np.clip(closing - 0.5, 0.0, None) / 0.5 + random.normal(0.0, 0.5, len(t))
    opening = SHUT_UNITS * (1.0 - closing) + random.normal(0.0, 0.05, len(t))
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["clock (ms)", "who", "opening", "force", "unused"])
        for at_ms, opens, presses in zip(np.round(1e3 * t, 3), np.round(opening, 3), np.round(force, 2), strict=True):
            rows.writerow([at_ms, "me", opens, presses, 0])
    return path
