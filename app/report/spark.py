"""A grasp's force as a line no larger than a word, drawn without a script."""

import numpy as np

from app.report.traces import Grid

WIDTH, HEIGHT, POINTS = 130, 34, 70


def spark(ticks: np.ndarray, force_n: np.ndarray, limit_n: np.ndarray, most_n: float) -> str:
    """SVG of a force, N, (n,) at `ticks`; dashed: the limit that was enforced at the end. `most_n` is the height."""
    grid = Grid.over(ticks, POINTS)
    points = grid.thin(ticks, force_n)
    if not np.isfinite(points).any() or most_n <= 0:
        return ""
    scale = (HEIGHT - 2) / most_n
    x = (np.arange(len(points)) * (WIDTH / max(len(points) - 1, 1))).tolist()
    y = (HEIGHT - 1 - np.clip(points, 0, most_n) * scale).tolist()
    path, pen = [], "M"
    for at, height in zip(x, y, strict=True):
        if height != height:  # a gap
            pen = "M"
            continue
        path.append(f"{pen}{at:.0f} {height:.1f}")
        pen = "L"
    limit = ""
    told_n = limit_n[np.isfinite(limit_n)]
    if len(told_n) and told_n[-1] <= most_n:
        at = HEIGHT - 1 - told_n[-1] * scale
        limit = f'<path class="limit" d="M0 {at:.1f}H{WIDTH}"/>'
    return (
        f'<svg class="spark" viewBox="0 0 {WIDTH} {HEIGHT}" aria-hidden="true">{limit}<path d="{"".join(path)}"/></svg>'
    )
