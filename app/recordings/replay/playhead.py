"""The class Playhead: position of a replay, and the ticks to show next. It has no clock: callers pass elapsed times."""

from dataclasses import dataclass, field

from app.messages.live import ReplayControl

ROUNDING_TICKS = 1e-6  # a position in seconds stands for a whole tick


@dataclass(slots=True)
class Playhead:
    """Position of a replay. `shown_tick` is the tick up to which everything has been shown.

    It jumps only in `apply_control`.
    """

    end_tick: int
    rate_hz: float
    playing: bool = True
    position_s: float = 0.0
    speed: float = 1.0
    shown_tick: int = field(default=0, init=False)

    @property
    def duration_s(self) -> float:
        return self.end_tick / self.rate_hz

    def apply_control(self, control: ReplayControl) -> bool:
        """Apply a viewer's control; return whether the position jumped. Playing at the end starts at the beginning."""
        if control.speed is not None:
            self.speed = control.speed
        jump_s = control.position_s
        if jump_s is None and control.playing and self.position_s >= self.duration_s:
            jump_s = 0.0
        if jump_s is not None:
            self.position_s = min(jump_s, self.duration_s)
            self.shown_tick = self._position_tick()
        if control.playing is not None:
            self.playing = control.playing
        return jump_s is not None

    def advance(self, elapsed_s: float) -> tuple[int, int]:
        """Advance and return the ticks to show now, from the first on, before the second; pause at the end."""
        begin = self.shown_tick
        if self.playing:
            self.position_s = min(self.position_s + elapsed_s * self.speed, self.duration_s)
            self.playing = self.position_s < self.duration_s
            self.shown_tick = self._position_tick()
        return begin, self.shown_tick

    def _position_tick(self) -> int:
        return min(int(self.position_s * self.rate_hz + ROUNDING_TICKS), self.end_tick)
