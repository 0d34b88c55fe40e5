"""How right, how early and how honest a learned library is on grasps that it was not learned from.

Three questions, from hard to easy. *Another recording*: each recording in turn is left out, where its tissue has
another one. *Another tissue*: each tissue is left out as a whole, and its grasps should be unknown. *Later grasps*: one
half in time of every recording is learned from, the other asked. The last one is too kind: it knows the session.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from config.errors import ConfigurationError
from config.schema import Identification, TissueLibrary, Tool
from estimator.decision import UNDECIDED, UNKNOWN, Decision
from estimator.learning.evidence import LearnedEvidence, LearnedGrasp
from estimator.learning.grasps import Recorded, RecordedGrasp

STEP_SAMPLES = 5  # as the session renews probabilities
CHECKPOINTS = (0.1, 0.2, 0.3, 0.5, 0.75)  # shares of the usual peak force, while it rises

Learn = Callable[[Sequence[Recorded]], TissueLibrary]
Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True)
class Answer:
    """What a library that does not know a grasp's recording says of it."""

    question: str
    recording: str
    grasp: int
    truth: str  # a label, or unknown
    label: str
    decided_s: float | None  # since the command left zero
    probabilities: dict[str, float]
    course: tuple[float, ...]  # of the truth, as the force passes each of CHECKPOINTS, and at the end
    likeliest: tuple[str, ...]  # at the same moments


@dataclass(frozen=True, slots=True)
class Fold:
    question: str
    learned: list[Recorded]
    asked: list[tuple[Recorded, str, frozenset[int]]]  # recording, right answer, positions of the grasps asked


def folds(recordings: Sequence[Recorded]) -> Iterator[Fold]:
    """All that can be asked of these recordings, in an order that does not depend on theirs."""
    recordings = sorted(recordings, key=lambda each: (each.label, each.sha256))
    labels = sorted({each.label for each in recordings})
    for left in recordings:
        rest = [each for each in recordings if each is not left]
        if left.label in {each.label for each in rest}:
            yield Fold("another recording", rest, [(left, left.label, _all(left))])
    for label in labels if len(labels) > 2 else []:
        rest = [each for each in recordings if each.label != label]
        strangers = [(each, UNKNOWN, _all(each)) for each in recordings if each.label == label]
        yield Fold("another tissue", rest, strangers)
    for late in (False, True):
        halves = [_half(each, late=late) for each in recordings]
        asked = [
            (each, each.label, frozenset(_all(each) - kept)) for each, (_, kept) in zip(recordings, halves, strict=True)
        ]
        yield Fold("later grasps" if not late else "earlier grasps", [half for half, _ in halves], asked)


def _all(recording: Recorded) -> frozenset[int]:
    return frozenset(range(len(recording.grasps)))


def _half(recording: Recorded, *, late: bool) -> tuple[Recorded, frozenset[int]]:
    """The earlier or later half, with the first grasp before it, which learning leaves out."""
    middle = len(recording.grasps) // 2
    kept = frozenset(range(middle, len(recording.grasps))) if late else frozenset(range(middle))
    grasps = tuple(grasp for i, grasp in enumerate(recording.grasps) if i in kept or i == 0)
    return replace(recording, grasps=grasps), kept | {0}


def validate(
    recordings: Sequence[Recorded], learn: Learn, tool: Tool, settings: Identification, progress: Progress
) -> list[Answer]:
    """Every grasp's answer to every question that these recordings allow.

    `learn`: the library that some of them make.
    """
    answers, todo = [], list(folds(recordings))
    for done, fold in enumerate(todo):
        progress(done / len(todo))
        learnable = [each for each in fold.learned if len(each.grasps) > 1]
        try:
            library = learn(learnable)
        except (ValueError, ConfigurationError):
            continue  # too little is left
        asker = _Asker(library, tool, settings)
        for recording, truth, positions in fold.asked:
            answers += asker.ask(fold.question, recording, truth if truth in library.tissues else UNKNOWN, positions)
    return answers


class _Asker:
    def __init__(self, library: TissueLibrary, tool: Tool, settings: Identification) -> None:
        self._evidence, self._settings = LearnedEvidence(library, tool, settings), settings
        self._names = (*library.tissues, UNKNOWN)
        self._rate_hz = tool.board.sample_rate_hz
        self._peak_v = library.learned.usual_peak_v if library.learned else 1.0

    def ask(self, question: str, recording: Recorded, truth: str, positions: frozenset[int]) -> Iterator[Answer]:
        shut_deg = None
        for i, grasp in enumerate(recording.grasps):
            learned = self._evidence.begin(shut_deg, first=i == 0)
            if i in positions and len(grasp.samples):
                yield self._answer(question, recording, truth, grasp, learned)
            else:
                learned.loading.take(grasp.samples)
            found = learned.loading.shut_deg
            if found is not None:
                shut_deg = found

    def _answer(
        self, question: str, recording: Recorded, truth: str, grasp: RecordedGrasp, learned: LearnedGrasp
    ) -> Answer:
        decision = Decision(self._names, self._settings, self._rate_hz)
        course: list[np.ndarray] = []
        start = int(grasp.samples["tick"][0])
        probabilities = self._evidence.prior
        for begin in range(0, len(grasp.samples), STEP_SAMPLES):
            samples = grasp.samples[begin : begin + STEP_SAMPLES]
            probabilities = learned.take(samples)
            decision.update(probabilities, int(samples["tick"][-1]))
            while len(course) < len(CHECKPOINTS) and learned.loading.peak_v >= CHECKPOINTS[len(course)] * self._peak_v:
                course.append(probabilities)
        course += [probabilities] * (len(CHECKPOINTS) + 1 - len(course))
        label = UNDECIDED if grasp.fault() and decision.label != UNKNOWN else decision.label
        at = self._names.index(truth)
        return Answer(
            question,
            recording.file,
            grasp.index,
            truth,
            label,
            None if label == UNDECIDED else (decision.decided_tick - start) / self._rate_hz,
            dict(zip(self._names, map(float, probabilities), strict=True)),
            tuple(float(each[at]) for each in course),
            tuple(self._names[int(each.argmax())] for each in course),
        )
