"""The interface TissueIdentifier, which the bank and its baselines share, and the bank with this interface."""

from typing import Protocol

import numpy as np

from config.schema import IdentificationSettings, TissueLibrary, Tool
from estimator.evidence import BankEvidence
from estimator.filter_bank import ContactStart, FilterBank, bank_columns
from estimator.kalman_filter import PARAMETERS


class TissueIdentifier(Protocol):
    """Interface of the estimators that studies compare: each identifies the tissue of one grasp, from contact on."""

    def start(self, first: np.void, contact: ContactStart) -> None:
        """Begin at the first sample in contact (dtype SAMPLE)."""
        ...

    def advance(self, samples: np.ndarray) -> None:
        """Process the following samples (dtype SAMPLE)."""
        ...

    def probabilities(self) -> np.ndarray:
        """Return the probabilities of the library's tissues and of `unknown`, (M + 1,)."""
        ...

    def log_parameters(self) -> np.ndarray:
        """Return the present estimate of log alpha, log beta, log d, (3,); NaN without an estimate."""
        ...


class BankIdentifier:
    """Graspwatch's own estimator: the bank and its evidence."""

    def __init__(self, bank: FilterBank, evidence: BankEvidence, dt_s: float) -> None:
        self.bank, self._evidence, self._dt_s = bank, evidence, dt_s
        self._contact_m, self._last_tick = 0.0, 0

    @classmethod
    def from_tool(cls, tool: Tool, library: TissueLibrary, settings: IdentificationSettings) -> "BankIdentifier":
        """Create the bank for a library's tissues on a tool."""
        bank = FilterBank.from_tool(tool, library)
        return cls(bank, BankEvidence(bank, library, settings), 1.0 / tool.board.sample_rate_hz)

    def start(self, first: np.void, contact: ContactStart) -> None:
        self._contact_m, self._last_tick = float(first["jaw_displacement_m"]), int(first["tick"])
        self.bank.start(contact)

    def advance(self, samples: np.ndarray) -> None:
        self.bank.advance(bank_columns(samples, self._contact_m, self._last_tick, self._dt_s))
        self._last_tick = int(samples["tick"][-1])

    def probabilities(self) -> np.ndarray:
        return self._evidence.probabilities()

    def log_parameters(self) -> np.ndarray:
        best = self.bank.find_likeliest_filter()
        return self.bank.state.mean[best, PARAMETERS].copy() if best >= 0 else np.full(3, np.nan)
