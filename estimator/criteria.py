"""The paper's criteria for a filter: convergence time and force error (Tables IV to VI)."""

import numpy as np


def convergence_samples(errors_n: np.ndarray, bound_n: float) -> np.ndarray:
    """Samples from which each filter's force error stays within its bound, (K,), for errors (n, K); NaN if it does not.

    A sample without an estimate counts as outside.
    """
    if not len(errors_n):
        return np.full(errors_n.shape[1], np.nan)
    outside = ~(np.abs(errors_n) <= bound_n)
    last_outside = len(errors_n) - 1 - np.argmax(outside[::-1], axis=0)
    first_inside = np.where(outside.any(axis=0), last_outside + 1, 0).astype(float)
    first_inside[outside[-1]] = np.nan
    return first_inside


class ForceErrors:
    """Errors of the filters' elastic forces against the measured force, over one grasp."""

    def __init__(self, filters: int, convergence_error: float) -> None:
        self._errors: list[np.ndarray] = [np.empty((0, filters))]
        self._convergence_share = convergence_error
        self._peak_n = 0.0
        self._sample_count = 0

    def append(self, filter_force_n: np.ndarray, force_n: np.ndarray) -> None:
        """Take samples: filters' forces (n, K), measured force (n,)."""
        self._errors.append(filter_force_n - force_n[:, None])
        self._peak_n = max(self._peak_n, float(force_n.max()))
        self._sample_count += len(force_n)

    def truncate(self, samples: int) -> None:
        """Forget all but the first samples."""
        self._errors = [self._concatenate()[:samples]]
        self._sample_count = len(self._errors[0])

    def __len__(self) -> int:
        """How many samples there are."""
        return self._sample_count

    def _concatenate(self) -> np.ndarray:
        if len(self._errors) > 1:
            self._errors = [np.concatenate(self._errors)]
        return self._errors[0]

    def convergence_samples(self) -> np.ndarray:
        """Samples after contact from which each filter's error stays within its bound, (K,); NaN if it does not.

        The bound is 15 % of the largest force (Section V).
        """
        return convergence_samples(self._concatenate(), self._convergence_share * self._peak_n)

    def mean_error_n(self) -> np.ndarray:
        """Mean error of each filter where it has an estimate, N, (K,); NaN where it never has."""
        errors = self._concatenate()
        sound = np.isfinite(errors)
        count = sound.sum(axis=0)
        total = np.where(sound, errors, 0.0).sum(axis=0)
        return np.divide(total, count, out=np.full(errors.shape[1], np.nan), where=count > 0)
