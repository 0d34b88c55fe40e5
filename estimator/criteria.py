"""The class ForceErrors: the paper's criteria for a filter, convergence time and force error (Tables IV to VI)."""

import numpy as np

MIN_ESTIMATED_SHARE = 0.5  # of a grasp's samples: with fewer estimates, a filter has no mean force error


def convergence_samples(errors_n: np.ndarray, bound_n: float) -> np.ndarray:
    """Return the sample from which each filter's force error stays within the bound, (K,); NaN if it does not.

    `errors_n` has shape (n, K). A sample without an estimate counts as outside.
    """
    if not len(errors_n):
        return np.full(errors_n.shape[1], np.nan)
    outside = ~(np.abs(errors_n) <= bound_n)
    last_outside = len(errors_n) - 1 - np.argmax(outside[::-1], axis=0)
    first_inside = np.where(outside.any(axis=0), last_outside + 1, 0).astype(float)
    first_inside[outside[-1]] = np.nan
    return first_inside


class ForceErrors:
    """Differences between the filters' elastic forces and the measured force over one grasp."""

    def __init__(self, filters: int, convergence_error: float) -> None:
        self._errors: list[np.ndarray] = [np.empty((0, filters))]
        self._convergence_share = convergence_error
        self._peak_n = 0.0
        self._sample_count = 0

    def append(self, filter_force_n: np.ndarray, force_n: np.ndarray) -> None:
        """Append samples: filters' forces (n, K) and measured force (n,), N."""
        self._errors.append(filter_force_n - force_n[:, None])
        self._peak_n = max(self._peak_n, float(force_n.max()))
        self._sample_count += len(force_n)

    def truncate(self, samples: int) -> None:
        """Discard all but the first `samples`."""
        self._errors = [self._concatenate()[:samples]]
        self._sample_count = len(self._errors[0])

    def __len__(self) -> int:
        """Return the number of samples."""
        return self._sample_count

    def _concatenate(self) -> np.ndarray:
        if len(self._errors) > 1:
            self._errors = [np.concatenate(self._errors)]
        return self._errors[0]

    def convergence_samples(self) -> np.ndarray:
        """Return the sample after contact from which each filter's error stays within the bound, (K,); NaN if never.

        The bound is a share of the largest force, 15 % in the paper (Section V).
        """
        return convergence_samples(self._concatenate(), self._convergence_share * self._peak_n)

    def mean_error_n(self) -> np.ndarray:
        """Return each filter's mean force error (its own less the measured), N, (K,).

        NaN for a filter that has no estimate of a part of the samples, because it has diverged.
        """
        errors = self._concatenate()
        sound = np.isfinite(errors)
        count = sound.sum(axis=0)
        total = np.where(sound, errors, 0.0).sum(axis=0)
        enough = count > MIN_ESTIMATED_SHARE * len(errors)
        return np.divide(total, count, out=np.full(errors.shape[1], np.nan), where=enough)
