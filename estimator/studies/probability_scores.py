"""Scores of probabilities: accuracy, calibration, confident errors, and the Bayes limit."""

import math
from dataclasses import dataclass

import numpy as np

from config.schema import TissueLibrary

CONFIDENCE_THRESHOLD = 0.95
BIN_COUNT = 10


def bayes_limit(library: TissueLibrary, log_parameters: np.ndarray, thickness_m: float | None) -> np.ndarray:
    """Return the probabilities, (M,), given a specimen's exact parameters, from the library's spreads alone.

    `log_parameters`: log alpha, log beta, log d, (3,). `thickness_m`: None if the tool does not measure it.
    """
    used = 3 if thickness_m is None else 4
    seen = np.append(log_parameters, math.log(thickness_m or 1.0))
    log_density = []
    for name, profile in library.tissues.items():
        spread = library.spread_of(name)
        centre = np.log([profile.alpha_n, profile.beta_per_m, profile.damping_kg_per_s, profile.thickness_m])
        sd = np.array([spread.log_alpha, spread.log_beta, spread.log_damping, spread.log_thickness])
        log_density.append(-np.sum(0.5 * ((seen - centre)[:used] / sd[:used]) ** 2 + np.log(sd[:used])))
    weights = np.exp(np.array(log_density) - max(log_density))
    return weights / weights.sum()


@dataclass(frozen=True, slots=True)
class Score:
    """Accuracy, calibration and confidence of a set of answers."""

    accuracy: float  # share of answers whose likeliest tissue is right
    calibration_error: float  # expected calibration error
    confident_wrong: float  # share of answers with a probability of at least 0.95 that are wrong
    confident: float  # share of answers with a probability of at least 0.95
    log_loss: float  # mean negative log probability of the truth


def score_answers(probabilities: np.ndarray, truth: np.ndarray) -> Score:
    """Score `probabilities`, (n, M + 1), against `truth`, (n,), the index of the right answer."""
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
