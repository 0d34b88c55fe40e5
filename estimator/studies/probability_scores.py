"""Functions that score probabilities: accuracy, calibration and confident errors."""

from dataclasses import dataclass

import numpy as np

CONFIDENCE_THRESHOLD = 0.95
BIN_COUNT = 10


@dataclass(frozen=True, slots=True)
class Score:
    """Accuracy, calibration and confidence of a set of answers."""

    accuracy: float  # share of answers whose likeliest tissue is right
    calibration_error: float  # expected calibration error
    confident_wrong: float  # share of answers with a probability of at least 0.95 that are wrong
    confident: float  # share of answers with a probability of at least 0.95
    log_loss: float  # mean negative log probability of the truth


def score_answers(probabilities: np.ndarray, truth: np.ndarray) -> Score:
    """Return the score of `probabilities`, (n, M + 1), for `truth`, (n,), the index of each right answer."""
    confidence, right = probabilities.max(axis=1), probabilities.argmax(axis=1) == truth
    of_truth = probabilities[np.arange(len(truth)), truth]
    return Score(
        accuracy=float(right.mean()),
        calibration_error=calibration_error(confidence, right),
        confident_wrong=float((~right & (confidence >= CONFIDENCE_THRESHOLD)).mean()),
        confident=float((confidence >= CONFIDENCE_THRESHOLD).mean()),
        log_loss=float(-np.log(np.maximum(of_truth, 1e-12)).mean()),
    )


def compute_reliability(confidence: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return mean confidence, share right and number for ten equal bins of confidence; NaN for an empty bin."""
    which = np.minimum((confidence * BIN_COUNT).astype(int), BIN_COUNT - 1)
    number = np.bincount(which, minlength=BIN_COUNT)
    with np.errstate(invalid="ignore"):
        mean = np.bincount(which, confidence, BIN_COUNT) / number
        share = np.bincount(which, right.astype(float), BIN_COUNT) / number
    return mean, share, number


def calibration_error(confidence: np.ndarray, right: np.ndarray) -> float:
    """Return the expected calibration error over ten equal bins."""
    mean, share, number = compute_reliability(confidence, right)
    filled = number > 0
    return float(np.sum(number[filled] * np.abs(mean - share)[filled]) / len(confidence))


def compute_confusion_matrix(probabilities: np.ndarray, truth: np.ndarray, answers: int) -> np.ndarray:
    """Return the share of each truth (rows) that gets each answer (columns)."""
    table = np.zeros((int(truth.max()) + 1, answers))
    np.add.at(table, (truth, probabilities.argmax(axis=1)), 1.0)
    return table / np.maximum(table.sum(axis=1, keepdims=True), 1.0)
