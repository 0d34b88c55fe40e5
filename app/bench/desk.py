"""Calibrations guided from the dashboard: readings come from the live samples, motion is a run like any other."""

import asyncio
import getpass
from pathlib import Path

from acquisition import bus
from acquisition.bench import fits, measuring
from acquisition.bench.checks import Signals
from acquisition.bench.fits import Fit, Pass
from acquisition.blocks import SampleBlock
from acquisition.safety import Safety
from app.arming import CALIBRATING
from app.bench.results import write_fit
from app.plan import ServicePlan
from app.station import Station
from app.wire import Calibration, CalibrationKind, CalibrationReading, CalibrationRequest, CalibrationResult, Constant
from config.errors import CalibrationError, RefusedError, ServiceError
from config.load import load_tool
from config.schema import Tool, ToolKind
from config.writing import check_folder

LATE_S = 3.0
STILL_S = {CalibrationKind.TARE: measuring.TARE_S, CalibrationKind.STRAIN: measuring.WEIGHT_S}
MOST_PLOTTED = 500
NOTHING = Calibration(what=None, values=[], readings=[], reading=False, problem=None, result=None)


class CalibrationDesk:
    """At most one calibration at a time; what it has read is kept until another one begins."""

    def __init__(self, plan: ServicePlan, station: Station) -> None:
        self._plan, self._station = plan, station
        self._newest = plan.tool_source or plan.tool.name  # each builds on the one before
        self._blocks: list[SampleBlock] | None = None
        self._arrived = asyncio.Event()
        self._asked: CalibrationRequest | None = None
        self._read: list[Signals | list[Pass]] = []
        self.state = NOTHING
        station.followers.append(self._take)

    def _take(self, block: SampleBlock) -> None:
        if self._blocks is not None:
            self._blocks.append(block)
            self._arrived.set()

    def begin(self, asked: CalibrationRequest) -> None:
        """Forget what was, and wait for the first reading.

        Raises:
            CalibrationError: the weights or gauges tell nothing.
            RefusedError: a reading is under way.
            ConfigurationError: the tool file could not be written.
        """
        self._check_idle()
        check_folder(self._folder)
        values = [0.0]
        if asked.what is CalibrationKind.STRAIN:
            values = fits.check_pulls(asked.values).tolist()
        elif asked.what is CalibrationKind.GEOMETRY:
            values = (fits.check_gauges([each * 1e-3 for each in asked.values]) * 1e3).tolist()
        self._asked, self._read = asked, []
        self.state = NOTHING.model_copy(update={"what": asked.what, "values": values})

    def abandon(self) -> None:
        """
        Raises:
            RefusedError: a reading is under way; a stop ends it.
        """
        self._check_idle()
        self._asked = None
        self.state = NOTHING

    def _check_idle(self) -> None:
        if self.state.reading:
            raise RefusedError("A reading is under way. Wait for it, or press STOP.")

    async def read(self, by: str | None) -> None:
        """Take the next reading; after the last one, fit, and write the tool file.

        Raises:
            RefusedError: nothing was begun, all is read, or the tool may not move now.
            ServiceError: the acquisition does not answer, or no samples come.
            CalibrationError: the reading cannot be trusted: it may be repeated.
        """
        self._check_idle()
        if self._asked is None or len(self._read) == len(self.state.values):
            raise RefusedError("Nothing is left to read: begin a calibration.")
        if self._station.runs.current:  # known before the first of its blocks has come
            raise RefusedError("A run is under way. Stop it first.")
        what, value = self._asked.what, self.state.values[len(self._read)]
        self._tell(reading=True, problem=None)
        try:
            found = await self._measure(what, value, by)
            self._read.append(found)
            self._tell(readings=[*self.state.readings, _described(value, found)])
            if len(self._read) == len(self.state.values):
                await self._finish(by)
        finally:
            self._blocks = None
            self._tell(reading=False)

    async def _measure(self, what: CalibrationKind, value: float, by: str | None) -> Signals | list[Pass]:
        try:
            found = await self._still(what, value, by) if what in STILL_S else await self._moved(what, value, by)
            if what is CalibrationKind.STRAIN:
                fits.check_steady(found, f"{value:g} N", self._tool())
        except CalibrationError as error:
            self._tell(problem=str(error))
            raise
        return found

    def _tell(self, **changes: object) -> None:
        self.state = self.state.model_copy(update=changes)

    def _tool(self) -> Tool:
        return load_tool(self._newest)

    async def _still(self, what: CalibrationKind, value: float, by: str | None) -> Signals:
        if self._station.arming.safety is Safety.ARMED:  # a weight would be a fault of its gage
            await self._station.arming.disarm(by)
        await self._put(value if what is CalibrationKind.STRAIN else 0.0, None)
        try:
            seconds = STILL_S[what]
            self._blocks, wanted = [], round(seconds * self._plan.tool.board.sample_rate_hz)
            async with asyncio.timeout(seconds + LATE_S):
                while sum(len(block.samples) for block in self._blocks) < wanted:
                    self._arrived.clear()
                    await self._arrived.wait()
        except TimeoutError:
            raise ServiceError("No samples arrive from the tool. See the alarms, then read again.") from None
        finally:
            taken, self._blocks = self._blocks or [], None
            await self._put(0.0, None)
        return measuring.signals_of(taken)

    async def _moved(self, what: CalibrationKind, value: float, by: str | None) -> list[Pass]:
        await self._put(0.0, value * 1e-3 if what is CalibrationKind.GEOMETRY else 0.0)
        try:
            self._blocks = []
            run = await self._station.start_run(measuring.shutting(), 1, None, by, self._unmeasured)
            while self._station.runs.current and self._station.runs.current.id == run.id:
                self._arrived.clear()
                await asyncio.wait_for(self._arrived.wait(), LATE_S)
            ended = self._station.runs.get(run.id) or run
            if ended.state.value != "finished":
                raise CalibrationError(f"The run was {ended.state.value}: {ended.why}. Mend that, and read again.")
        except TimeoutError:
            raise ServiceError("No samples arrive from the tool. See the alarms, then read again.") from None
        finally:
            taken, self._blocks = self._blocks or [], None
            await self._put(0.0, None)
            arming = self._station.arming
            if arming.safety is Safety.ARMED and arming.unmeasured == CALIBRATING:
                await arming.disarm(by)  # it was armed for this alone
        played = measuring.signals_of([block for block in taken if block.run == run.id])
        return measuring.passes_played(played, self._tool())

    async def _put(self, pull_n: float, gauge_m: float | None) -> None:
        """What a person does at a real tool."""
        if self._plan.tool.kind is ToolKind.SIMULATED:
            await self._station.put(bus.Put(pull_n, gauge_m))

    async def _finish(self, by: str | None) -> None:
        """Fit, and write, in a thread: the first fit of a service loads what it needs. What is refused is told."""
        asked, tool = self._asked, self._tool()
        person = asked.person or by or getpass.getuser()
        try:
            fit = await asyncio.to_thread(self._fit, tool)
        except CalibrationError as error:
            self._tell(problem=f"{error} Nothing was written.")
            raise
        path = await asyncio.to_thread(write_fit, fit, self._newest, person, asked.valid_days, self._folder)
        self._newest = str(path)
        self._tell(result=_result(fit, tool, path))
        names = ", ".join(each.key for each in fit.constants)
        self._station.tell_event(f"Calibrated: {names}; written to {path}", by=by)

    @property
    def _unmeasured(self) -> str:
        """Why the tool may move without a measured force scale, where it has none."""
        return "" if self._plan.tool.has_known_scale else CALIBRATING

    @property
    def _folder(self) -> Path:
        return self._plan.data / "tools"

    def _fit(self, tool: Tool) -> Fit:
        match self._asked.what:
            case CalibrationKind.TARE:
                return fits.tare(self._read[0], tool)
            case CalibrationKind.STRAIN:
                return fits.strain(self.state.values, self._read, tool)
            case CalibrationKind.STRETCH:
                return fits.stretch(self._read[0], tool)
            case CalibrationKind.GEOMETRY:
                passes = [measuring.merged(found) for found in self._read]
                return fits.geometry([each * 1e-3 for each in self.state.values], passes, tool)


def _described(value: float, found: Signals | list[Pass]) -> CalibrationReading:
    signals = found if isinstance(found, Signals) else measuring.merged(found)
    return CalibrationReading(
        value=value, strain_v=float(signals.strain_v.mean()), encoder_deg=float(signals.encoder_deg.mean())
    )


def _result(fit: Fit, tool: Tool, path: Path) -> CalibrationResult:
    thin = slice(None, None, max(1, len(fit.points[0]) // MOST_PLOTTED))
    constants = [
        Constant(
            key=each.key,
            value=each.value,
            low=each.low,
            high=each.high,
            unit=each.unit,
            residual=each.residual,
            residual_unit=each.residual_unit,
            readings=each.readings,
            before=fits.before(each, tool),
        )
        for each in fit.constants
    ]
    return CalibrationResult(
        file=str(path),
        constants=constants,
        remarks=list(fit.remarks),
        axes=list(fit.axes),
        x=fit.points[0][thin].tolist(),
        y=fit.points[1][thin].tolist(),
        line_x=fit.line[0].tolist(),
        line_y=fit.line[1].tolist(),
    )
