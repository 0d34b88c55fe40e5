"""When a tissue is named, and when the name is withdrawn."""

from dataclasses import dataclass

import numpy as np

from config.schema import Identification

UNDECIDED = "undecided"
UNKNOWN = "unknown"


@dataclass(slots=True)
class Decision:
    """The label of one grasp over time: named at `decide_at`, withdrawn below `withdraw_below`."""

    names: tuple[str, ...]  # the library's tissues, then `unknown`
    settings: Identification
    label: str = UNDECIDED
    decided_tick: int = -1

    def update(self, probabilities: np.ndarray, tick: int) -> None:
        """Take the probabilities, (K + 1,), at a tick."""
        top = int(np.argmax(probabilities))
        if self.label != UNDECIDED and probabilities[self.names.index(self.label)] < self.settings.withdraw_below:
            self.reset()
        if probabilities[top] >= self.settings.decide_at and self.names[top] != self.label:
            self.label, self.decided_tick = self.names[top], tick

    def reset(self) -> None:
        """Withdraw the label."""
        self.label, self.decided_tick = UNDECIDED, -1
