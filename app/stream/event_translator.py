"""The class EventTranslator: publishes identifications, withdrawn names, force alarms, grasps from estimate blocks."""

from collections.abc import Callable

from pydantic import BaseModel

from app.messages.alarms import AlarmKind
from app.messages.grasps import Grasp, Identification
from app.messages.live import EventMessage
from app.stream.alarms import PRIORITY_RANK, AlarmManager
from config.schema import TissueLibrary
from estimator.estimate_block import EstimateBlock, GraspRecord, IdentificationResult
from estimator.force_alarms import Priority

IDENTIFICATION_RATE_HZ = 10.0


class EventTranslator:
    """Translator of one source's estimate blocks into messages, which it publishes."""

    def __init__(
        self,
        library: TissueLibrary,
        rate_hz: float,
        dose_threshold_n_s: float,
        alarms: AlarmManager,
        publish: Callable[[BaseModel], None],
        on_grasp: Callable[[Grasp], None],
    ) -> None:
        """`dose_threshold_n_s`: displayed dose on one spot at which an alarm begins, N s."""
        self._library = library
        self._dose_threshold_n_s, self._spot_dose_n_s = dose_threshold_n_s, 0.0
        self._identification_period_ticks = rate_hz / IDENTIFICATION_RATE_HZ
        self._alarms = alarms
        self._publish = publish
        self._on_grasp = on_grasp
        self._published_tick = 0
        self._force_warnings: list[Priority] = []  # of the grasp under way, the highest of each rise
        self._rising = False
        self._held_back = False
        self._newest: tuple[IdentificationResult, float] | None = None  # and its time, ms

    @property
    def identification(self) -> Identification | None:
        """The newest identification, published or not."""
        return Identification.from_result(*self._newest) if self._newest else None

    def process(self, block: EstimateBlock, at_ms: float, sampled_ms: float) -> None:
        """Publish a block's ended grasps, identification, withdrawn labels and alarms at `at_ms`.

        `sampled_ms` is the time of its last sample.
        """
        for record in block.ended:
            self._end_grasp(record)
        self._publish_identification(block, at_ms)
        for withdrawal in block.withdrawn:
            reason = withdrawal.why or f"{100 * withdrawal.probability:.0f} % now"
            text = f"{self._title(withdrawal.label)} withdrawn: {reason}"
            self._publish(EventMessage(server_time_ms=at_ms, text=text))
        for alarm in block.alarms:
            self._add_force_warning(alarm.priority)
            self._alarms.update_force_alarm(alarm, sampled_ms)

    def _publish_identification(self, block: EstimateBlock, at_ms: float) -> None:
        """Publish the identification at every change, and ten times a second during a grasp."""
        result, before = block.identification, self._newest
        self._newest = result, at_ms
        if result.holding_back and not self._held_back:
            at = "" if result.limit_n is None else f" at {result.limit_n:.2f} N"
            text = f"The limiter holds the motor back{at}"
            self._publish(EventMessage(server_time_ms=at_ms, text=text))
        self._held_back |= result.holding_back
        self._check_dose(result, at_ms)
        changed = before is None or _change_key(before[0]) != _change_key(result)
        due = result.in_grasp and not 0 <= result.tick - self._published_tick < self._identification_period_ticks
        if changed or due:
            self._published_tick = result.tick
            self._publish(Identification.from_result(result, at_ms))
            self._alarms.update_peak_force(result.force_n)

    def _check_dose(self, result: IdentificationResult, at_ms: float) -> None:
        """Raise an alarm when the dose on a spot passes the threshold, once for each spot."""
        before, self._spot_dose_n_s = self._spot_dose_n_s, result.spot_dose_n_s or 0.0
        if before < self._dose_threshold_n_s <= self._spot_dose_n_s:
            over = f"{self._dose_threshold_n_s:.0f} N s"
            text = f"Force over time on the spot of grasp {result.grasp} is above {over}: grasp another spot"
            self._alarms.raise_latched("dose", AlarmKind.FORCE, text, at_ms)

    def _add_force_warning(self, priority: Priority | None) -> None:
        if priority is None:
            self._rising = False
        elif not self._rising:
            self._rising = True
            self._force_warnings.append(priority)
        else:
            self._force_warnings[-1:] = [max(self._force_warnings[-1], priority, key=PRIORITY_RANK.__getitem__)]

    def _end_grasp(self, record: GraspRecord) -> None:
        self._on_grasp(Grasp.from_record(record, self._force_warnings))
        self._force_warnings, self._rising, self._held_back = [], False, False

    def _title(self, label: str) -> str:
        profile = self._library.tissues.get(label)
        return profile.title if profile else label.capitalize()


def _change_key(result: IdentificationResult) -> tuple[object, ...]:
    return result.label, result.in_grasp, result.in_contact, result.grasp, result.holding_back, result.spots
