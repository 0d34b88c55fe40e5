"""The function that draws a grasp's force as a line of a word's size, without a script."""

import numpy as np
from markupsafe import Markup

from app.analysis.report.downsampling import TimeGrid

WIDTH_PX, HEIGHT_PX, MAX_POINTS = 130, 34, 70


def render_sparkline(ticks: np.ndarray, force_n: np.ndarray, limit_n: np.ndarray, max_force_n: float) -> Markup:
    """Return the SVG of a force, N, (n,) at `ticks`, `max_force_n` high; the limit enforced last is dashed."""
    grid = TimeGrid.from_ticks(ticks, MAX_POINTS)
    points = grid.downsample(ticks, force_n)
    if not np.isfinite(points).any() or max_force_n <= 0:
        return Markup()
    scale = (HEIGHT_PX - 2) / max_force_n
    x = (np.arange(len(points)) * (WIDTH_PX / max(len(points) - 1, 1))).tolist()
    y = (HEIGHT_PX - 1 - np.clip(points, 0, max_force_n) * scale).tolist()
    path, pen = [], "M"
    for at, height in zip(x, y, strict=True):
        if height != height:  # a gap
            pen = "M"
            continue
        path.append(f"{pen}{at:.0f} {height:.1f}")
        pen = "L"
    limit = ""
    told_n = limit_n[np.isfinite(limit_n)]
    if len(told_n) and told_n[-1] <= max_force_n:
        at = HEIGHT_PX - 1 - told_n[-1] * scale
        limit = f'<path class="limit" d="M0 {at:.1f}H{WIDTH_PX}"/>'
    curve = f'<path d="{"".join(path)}"/>'
    svg = f'<svg class="spark" viewBox="0 0 {WIDTH_PX} {HEIGHT_PX}" aria-hidden="true">{limit}{curve}</svg>'
    return Markup(svg)  # numbers alone
