"""The function that leaves whole recordings out, and asks the library learned from the others about them.

Everything is refitted inside each fold, the usual peak of the force and the spread between spots included.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from config.errors import ConfigurationError
from config.schema import IdentificationSettings, TissueLibrary, Tool
from estimator.decision import NO_ANSWER, UNDECIDED, UNKNOWN
from estimator.learning.cross_validation import FoldEvaluator, LibraryLearner, Progress, ValidationAnswer
from estimator.learning.recorded_grasps import LabeledRecording

SPOT_GRASPS = (1, 2, 3, 5, 10)  # numbers of finished grasps after which a spot is judged, beside all of them


@dataclass(frozen=True, slots=True)
class SpotAnswer:
    """Answer for a spot after its first `grasps` grasps."""

    grasps: int
    label: str
    probabilities: dict[str, float]


@dataclass(frozen=True, slots=True)
class RecordingResult:
    """Answers for one recording that was left out.

    `others` is the number of recordings of its tissue that the library was learned from; without any, the right answer
    is *unknown*. `spot` holds the answers for its spot, the last one after all grasps.
    """

    recording: LabeledRecording
    truth: str
    others: int
    grasps: tuple[ValidationAnswer, ...]
    spot: tuple[SpotAnswer, ...]


def leave_recordings_out(
    recordings: Sequence[LabeledRecording],
    learn: LibraryLearner,
    tool: Tool,
    settings: IdentificationSettings,
    progress: Progress,
) -> tuple[list[RecordingResult], list[RecordingResult]]:
    """Return the results with each recording left out, and those with its whole tissue left out.

    The first list lacks recordings of a tissue that has no other recording, the second one is empty for fewer than
    three tissues: the libraries of those folds could not be learned.
    """
    recordings = sorted(recordings, key=lambda each: (each.label, each.file, each.sha256))
    labels = sorted({each.label for each in recordings})
    spots, tissues = [], []
    for done, left in enumerate(recordings):
        rest = [each for each in recordings if each.sha256 != left.sha256]
        own = [each for each in rest if each.label == left.label]
        progress(2 * done / (2 * len(recordings)))
        if own:
            spots += _evaluate(left, left.label, len(own), rest, learn, tool, settings)
        progress((2 * done + 1) / (2 * len(recordings)))
        if len(labels) > 2:
            others = [each for each in rest if each.label != left.label]
            tissues += _evaluate(left, UNKNOWN, 0, others, learn, tool, settings)
    return spots, tissues


def _evaluate(
    left: LabeledRecording,
    truth: str,
    others: int,
    training: Sequence[LabeledRecording],
    learn: LibraryLearner,
    tool: Tool,
    settings: IdentificationSettings,
) -> list[RecordingResult]:
    """Return the result, or nothing if no library can be learned from the rest."""
    try:
        library = learn([each for each in training if len(each.grasps) > 1])
    except (ValueError, ConfigurationError):
        return []
    truth = truth if truth in library.tissues else UNKNOWN  # no grasp of it could be learned from
    evaluator = FoldEvaluator(library, tool, settings)
    answers: list[ValidationAnswer] = []
    spot: list[SpotAnswer] = []
    for answer in evaluator.evaluate(left.file, left, truth, frozenset(range(len(left.grasps)))):
        if answers and len(answers) in SPOT_GRASPS:  # the generator has added the grasps before this one
            spot.append(_answer_spot(evaluator, library, settings, answers))
        answers.append(answer)
    if answers:
        spot.append(_answer_spot(evaluator, library, settings, answers))
    return [RecordingResult(left, truth, others, tuple(answers), tuple(spot))]


def _answer_spot(
    evaluator: FoldEvaluator, library: TissueLibrary, settings: IdentificationSettings, answers: list[ValidationAnswer]
) -> SpotAnswer:
    names = (*library.tissues, UNKNOWN)
    probabilities = evaluator.spot.probabilities()
    top = int(np.argmax(probabilities))
    label = names[top] if probabilities[top] >= settings.decide_at else UNDECIDED
    if all(each.label == NO_ANSWER for each in answers):
        label = NO_ANSWER
    return SpotAnswer(len(answers), label, dict(zip(names, map(float, probabilities), strict=True)))
