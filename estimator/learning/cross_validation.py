"""Functions that test learned libraries on grasps that they were not learned from: accuracy, speed, calibration.

Three questions, from hard to easy. *Another recording*: each recording in turn is left out, if its tissue has another
one. *Another tissue*: each tissue is left out as a whole, and its grasps should be unknown. *Later grasps*: one half
of every recording is learned from, the other half tested. The last one is too optimistic: it knows the session.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from config.errors import ConfigurationError
from config.schema import IdentificationSettings, TissueLibrary, Tool
from estimator.decision import NO_ANSWER, NOT_NAMED, UNKNOWN, Decision
from estimator.learning.recorded_grasps import LabeledRecording, RecordedGrasp
from estimator.loading.learned_evidence import LearnedEvidence, LearnedGrasp
from estimator.spots import LearnedSpot

STEP_SAMPLES = 5  # probabilities are updated after as many samples as in `TissueEstimator`
FORCE_CHECKPOINTS = (0.1, 0.2, 0.3, 0.5, 0.75)  # shares of the usual peak force, while it rises
TIME_CHECKPOINTS_S = (0.1, 0.15, 0.3)  # since the command left zero

LibraryLearner = Callable[[Sequence[LabeledRecording]], TissueLibrary]
Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True)
class ValidationAnswer:
    """Answer for one grasp from a library that was learned without this grasp."""

    question: str
    recording: str
    grasp: int
    truth: str  # a label, or unknown
    label: str
    decided_s: float | None  # since the command left zero
    probabilities: dict[str, float]
    truth_probabilities: tuple[float, ...]  # of the truth, at each of FORCE_CHECKPOINTS and at the end
    most_likely: tuple[str, ...]  # at the same moments
    most_likely_in_time: tuple[str, ...]  # at TIME_CHECKPOINTS_S


@dataclass(frozen=True, slots=True)
class Fold:
    question: str
    training: list[LabeledRecording]
    tests: list[tuple[LabeledRecording, str, frozenset[int]]]  # recording, right answer, positions of tested grasps


def folds(recordings: Sequence[LabeledRecording]) -> Iterator[Fold]:
    """Yield all folds that these recordings allow, in an order independent of theirs."""
    recordings = sorted(recordings, key=lambda each: (each.label, each.sha256))
    labels = sorted({each.label for each in recordings})
    for left in recordings:
        rest = [each for each in recordings if each is not left]
        if left.label in {each.label for each in rest}:
            yield Fold("another recording", rest, [(left, left.label, _all_positions(left))])
    for label in labels if len(labels) > 2 else []:
        rest = [each for each in recordings if each.label != label]
        left_out = [(each, UNKNOWN, _all_positions(each)) for each in recordings if each.label == label]
        yield Fold("another tissue", rest, left_out)
    for late in (False, True):
        halves = [_select_half(each, late=late) for each in recordings]
        asked = [
            (each, each.label, frozenset(_all_positions(each) - kept))
            for each, (_, kept) in zip(recordings, halves, strict=True)
        ]
        yield Fold("later grasps" if not late else "earlier grasps", [half for half, _ in halves], asked)


def _all_positions(recording: LabeledRecording) -> frozenset[int]:
    return frozenset(range(len(recording.grasps)))


def _select_half(recording: LabeledRecording, *, late: bool) -> tuple[LabeledRecording, frozenset[int]]:
    """Return the earlier or later half and its positions, always with the first grasp, which learning leaves out."""
    middle = len(recording.grasps) // 2
    kept = frozenset(range(middle, len(recording.grasps))) if late else frozenset(range(middle))
    grasps = tuple(grasp for i, grasp in enumerate(recording.grasps) if i in kept or i == 0)
    return replace(recording, grasps=grasps), kept | {0}


def cross_validate(
    recordings: Sequence[LabeledRecording],
    learn: LibraryLearner,
    tool: Tool,
    settings: IdentificationSettings,
    progress: Progress,
) -> list[ValidationAnswer]:
    """Return the answers for all tested grasps of all folds; `learn` makes a library from recordings."""
    answers, todo = [], list(folds(recordings))
    for done, fold in enumerate(todo):
        progress(done / len(todo))
        learnable = [each for each in fold.training if len(each.grasps) > 1]
        try:
            library = learn(learnable)
        except (ValueError, ConfigurationError):
            continue  # too few recordings or grasps are left
        asker = FoldEvaluator(library, tool, settings)
        for recording, truth, positions in fold.tests:
            answers += asker.evaluate(
                fold.question, recording, truth if truth in library.tissues else UNKNOWN, positions
            )
    return answers


class FoldEvaluator:
    """Evaluator of one fold: it applies the fold's library to grasps that the library was not learned from."""

    def __init__(self, library: TissueLibrary, tool: Tool, settings: IdentificationSettings) -> None:
        self._evidence, self._settings = LearnedEvidence(library, tool, settings), settings
        self._names = (*library.tissues, UNKNOWN)
        self._rate_hz = tool.board.sample_rate_hz
        self._peak_v = library.learned.usual_peak_v if library.learned else 1.0

    def evaluate(
        self, question: str, recording: LabeledRecording, truth: str, positions: frozenset[int]
    ) -> Iterator[ValidationAnswer]:
        """Yield the answers for the grasps of a recording at these positions."""
        shut_deg = None
        self._evidence.use_conditions(recording.conditions)
        self.spot = LearnedSpot(self._evidence)
        for i, grasp in enumerate(recording.grasps):
            learned = self._evidence.start_grasp(shut_deg, first=i == 0)
            if i in positions and len(grasp.samples):
                yield self._evaluate_grasp(question, recording, truth, grasp, learned)
            else:
                learned.process(grasp.samples)
            if not grasp.find_fault() and len(grasp.samples):
                self.spot.append(learned)
            found = learned.loading_curve.jaw_closure_deg
            if found is not None:
                shut_deg = found

    def _evaluate_grasp(
        self, question: str, recording: LabeledRecording, truth: str, grasp: RecordedGrasp, learned: LearnedGrasp
    ) -> ValidationAnswer:
        decision = Decision(self._names, self._settings, self._rate_hz)
        course: list[np.ndarray] = []
        timed: list[np.ndarray] = []
        start = int(grasp.samples["tick"][0])
        probabilities = self._evidence.prior
        for begin in range(0, len(grasp.samples), STEP_SAMPLES):
            samples = grasp.samples[begin : begin + STEP_SAMPLES]
            probabilities = learned.process(samples)
            decision.update(probabilities, int(samples["tick"][-1]), complete=learned.loading_curve.ended)
            while (
                len(timed) < len(TIME_CHECKPOINTS_S)
                and begin + len(samples) >= self._rate_hz * TIME_CHECKPOINTS_S[len(timed)]
            ):
                timed.append(probabilities)
            while (
                len(course) < len(FORCE_CHECKPOINTS)
                and learned.loading_curve.peak_v >= FORCE_CHECKPOINTS[len(course)] * self._peak_v
            ):
                course.append(probabilities)
        timed += [probabilities] * (len(TIME_CHECKPOINTS_S) - len(timed))
        course += [probabilities] * (len(FORCE_CHECKPOINTS) + 1 - len(course))
        label = NO_ANSWER if grasp.find_fault() else decision.label
        at = self._names.index(truth)
        return ValidationAnswer(
            question,
            recording.file,
            grasp.index,
            truth,
            label,
            None if label in NOT_NAMED else (decision.decided_tick - start) / self._rate_hz,
            dict(zip(self._names, map(float, probabilities), strict=True)),
            tuple(float(each[at]) for each in course),
            tuple(self._names[int(each.argmax())] for each in course),
            tuple(self._names[int(each.argmax())] for each in timed),
        )
