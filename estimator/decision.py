"""The class Decision, which decides when a tissue is named and when the name is withdrawn."""

from dataclasses import dataclass

import numpy as np

from config.schema import IdentificationSettings

UNDECIDED = "undecided"
UNKNOWN = "unknown"
NO_ANSWER = "no_answer"  # of a grasp with a sensor fault; never a decision
NOT_NAMED = (UNDECIDED, NO_ANSWER)


@dataclass(slots=True)
class Decision:
    """The label of one grasp, with hysteresis.

    A tissue is named once its probability has been at least `decide_at` for `confirm_s`. The name is withdrawn when the
    probability falls below `withdraw_below`.
    """

    names: tuple[str, ...]  # the library's tissues, then `unknown`
    settings: IdentificationSettings
    rate_hz: float
    label: str = UNDECIDED
    decided_tick: int = -1
    _candidate: str = UNDECIDED
    _candidate_tick: int = -1

    def update(self, probabilities: np.ndarray, tick: int, *, complete: bool = False) -> None:
        """Update the label with the probabilities, (M + 1,), at a tick.

        With `complete` evidence the probabilities no longer move. So a name needs `decide_at`, without the hysteresis.
        """
        least = self.settings.decide_at if complete else self.settings.withdraw_below
        if self.label != UNDECIDED and probabilities[self.names.index(self.label)] < least:
            self.label, self.decided_tick = UNDECIDED, -1
        top = int(probabilities.argmax())
        candidate = self.names[top] if probabilities[top] >= self.settings.decide_at else UNDECIDED
        if candidate != self._candidate:
            self._candidate, self._candidate_tick = candidate, tick
        held_s = (tick - self._candidate_tick) / self.rate_hz
        if candidate not in (UNDECIDED, self.label) and held_s >= self.settings.confirm_s:
            self.label, self.decided_tick = candidate, tick
