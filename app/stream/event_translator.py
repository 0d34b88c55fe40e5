"""The class EventTranslator: publishes identifications, withdrawn names, force alarms, grasps from estimate blocks."""

from collections.abc import Callable

from pydantic import BaseModel

from app.messages.grasps import Grasp, Identification
from app.messages.live import EventMessage
from app.stream.alarms import PRIORITY_RANK, AlarmManager
from config.schema import TissueLibrary
from estimator.estimate_block import EstimateBlock, GraspRecord
from estimator.force_alarms import Priority

IDENTIFICATION_RATE_HZ = 10.0


class EventTranslator:
    """Translator of one source's estimate blocks into messages, which it publishes."""

    def __init__(
        self,
        library: TissueLibrary,
        rate_hz: float,
        alarms: AlarmManager,
        publish: Callable[[BaseModel], None],
        on_grasp: Callable[[Grasp], None],
    ) -> None:
        self._library = library
        self._identification_period_ticks = rate_hz / IDENTIFICATION_RATE_HZ
        self._alarms = alarms
        self._publish = publish
        self._on_grasp = on_grasp
        self._published_tick = 0
        self._force_warnings: list[Priority] = []  # of the grasp under way, the highest of each rise
        self._rising = False
        self._held_back = False
        self.identification: Identification | None = None

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
        message = Identification.from_result(block.identification, at_ms)
        before, self.identification = self.identification, message
        if message.holding_back and not self._held_back:
            at = "" if message.limit_n is None else f" at {message.limit_n:.2f} N"
            text = f"The limiter holds the motor back{at}"
            self._publish(EventMessage(server_time_ms=at_ms, text=text))
        self._held_back |= message.holding_back
        changed = before is None or _change_key(before) != _change_key(message)
        due = message.in_grasp and not 0 <= message.tick - self._published_tick < self._identification_period_ticks
        if changed or due:
            self._published_tick = message.tick
            self._publish(message)
            self._alarms.update_peak_force(message.force_n)

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


def _change_key(message: Identification) -> tuple[object, ...]:
    return message.label, message.in_grasp, message.in_contact, message.grasp, message.holding_back, message.spots
