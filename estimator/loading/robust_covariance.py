"""Functions that estimate centers and covariances, robust against outlying grasps."""

from collections.abc import Sequence

import numpy as np

from estimator.loading.constants import POOLED_WEIGHT, ROBUST_DEGREES_OF_FREEDOM, SHAPE_WEIGHT

ITERATIONS = 30
MAD_TO_SD = 1.4826  # of a Gaussian


def robust_scatter(
    groups: Sequence[np.ndarray], floor_var: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray]:
    """Return each group's center, its rows' weights, and the covariance within all groups together.

    The weights are those of a Student's t with `ROBUST_DEGREES_OF_FREEDOM`, so an outlying grasp counts less.

    Args:
        groups: arrays of shape (n, p), n at least 1.
        floor_var: variance added to each of the p columns, (p,), positive.

    Returns:
        Centers, each (p,); weights, each (n,); covariance (p, p), positive definite.
    """
    p, total = len(floor_var), max(sum(len(rows) - 1 for rows in groups), 1)
    centres = [np.median(rows, axis=0) for rows in groups]
    off = np.concatenate([rows - centre for rows, centre in zip(groups, centres, strict=True)])
    cov = np.diag((MAD_TO_SD * np.median(np.abs(off), axis=0)) ** 2 + floor_var)
    weights: list[np.ndarray] = []
    for _ in range(ITERATIONS):
        information = np.linalg.inv(cov)
        weights, moments = [], np.zeros((p, p))
        for i, rows in enumerate(groups):
            off = rows - centres[i]
            weight = (ROBUST_DEGREES_OF_FREEDOM + p) / (
                ROBUST_DEGREES_OF_FREEDOM + np.einsum("ij,jk,ik->i", off, information, off)
            )
            centres[i] = weight @ rows / weight.sum()
            off = rows - centres[i]
            moments += (weight[:, None] * off).T @ off
            weights.append(weight)
        diagonal = np.diag(np.diag(moments) / total)
        cov = (moments + SHAPE_WEIGHT * diagonal) / (total + SHAPE_WEIGHT) + np.diag(floor_var)
    return centres, weights, cov


def compute_robust_mean(rows: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the mean (p,) of rows (n, p) that scatter with `covariance` (p, p), and how many rows it is worth.

    Outlying rows count less, with the weights of `robust_scatter`.
    """
    information, mean = np.linalg.inv(covariance), np.median(rows, axis=0)
    weight = np.ones(len(rows))
    for _ in range(ITERATIONS):
        off = rows - mean
        distance = np.einsum("ij,jk,ik->i", off, information, off)
        weight = (ROBUST_DEGREES_OF_FREEDOM + rows.shape[1]) / (ROBUST_DEGREES_OF_FREEDOM + distance)
        mean = weight @ rows / weight.sum()
    return mean, float(weight.sum() ** 2 / (weight**2).sum())


def shrunk_scatter(
    groups: Sequence[np.ndarray], centres: Sequence[np.ndarray], weights: Sequence[np.ndarray], pooled: np.ndarray
) -> np.ndarray:
    """Return the covariance (p, p) within one tissue's groups, shrunk toward `pooled` by `POOLED_WEIGHT` grasps."""
    moments, count = POOLED_WEIGHT * pooled, POOLED_WEIGHT
    for rows, centre, weight in zip(groups, centres, weights, strict=True):
        off = rows - centre
        moments = moments + (weight[:, None] * off).T @ off
        count += len(rows) - 1
    return moments / count
