"""The class CalibrationSession: calibrations guided from the dashboard, with live samples and ordinary runs."""

import asyncio
from itertools import dropwhile
from pathlib import Path

from acquisition import bus
from acquisition.bench import calibration_bench, fits
from acquisition.bench.calibration_file import write_calibration_file
from acquisition.bench.checks import RawSignals
from acquisition.bench.fits import CalibrationFit, ForcePass
from acquisition.safety_state_machine import Safety
from acquisition.sample_block import SampleBlock
from app.host.computer_user import computer_user_name
from app.messages.calibration import (
    Calibration,
    CalibrationKind,
    CalibrationReading,
    CalibrationRequest,
    CalibrationResult,
    Constant,
)
from app.service.arming import CALIBRATION_ARM_REASON
from app.service.tool_service import ToolService
from config.errors import CalibrationError, RefusedError, ServiceError
from config.load import load_tool
from config.schema import Tool, ToolKind
from config.service_plan import ServicePlan
from config.writing import check_writable

SAMPLE_TIMEOUT_S = 3.0
REST_DURATIONS_S = {
    CalibrationKind.TARE: calibration_bench.TARE_S,
    CalibrationKind.STRAIN: calibration_bench.WEIGHT_S,
    CalibrationKind.FORCE: calibration_bench.WEIGHT_S,
}
MAX_PLOT_POINTS = 500
NO_CALIBRATION = Calibration(what=None, values=[], readings=[], reading=False, problem=None, result=None)


class CalibrationSession:
    """The service's calibration, one at a time; `state` stays until another one begins or it is discarded."""

    def __init__(self, plan: ServicePlan, tool_service: ToolService) -> None:
        self._plan, self._tool_service = plan, tool_service
        self._newest_file: str | None = None  # of the last calibration, unless another tool file was put to use since
        self._is_changing_tool = False
        self._collected_blocks: list[SampleBlock] | None = None
        self._block_arrived = asyncio.Event()
        self._request: CalibrationRequest | None = None
        self._rest_readings: list[RawSignals] = []
        self._motion_readings: list[list[ForcePass]] = []
        self.state = NO_CALIBRATION
        tool_service.receiver.listeners.append(self._on_block)

    @property
    def tool_source(self) -> str:
        """Name or path of the tool file that the next calibration builds on: that of the one before."""
        return self._newest_file or self._plan.tool_source or self._plan.tool.name

    def _on_block(self, block: SampleBlock) -> None:
        if self._collected_blocks is not None:
            self._collected_blocks.append(block)
            self._block_arrived.set()

    def begin(self, request: CalibrationRequest) -> None:
        """Replace the last calibration, and wait for the first reading.

        Raises:
            CalibrationError: there are too few weights or gauges, or impossible ones.
            RefusedError: a reading is under way.
            ConfigurationError: the tool file could not be written.
        """
        self._check_idle()
        if request.what in (CalibrationKind.STRAIN, CalibrationKind.STRETCH, CalibrationKind.GEOMETRY):
            fits.check_has_linkage(self._plan.tool, request.what.value)
        check_writable(self._folder)
        values = [0.0]
        if request.what is CalibrationKind.STRAIN:
            values = fits.check_pulls(request.values).tolist()
        elif request.what is CalibrationKind.FORCE:
            values = fits.check_jaw_forces(request.values).tolist()
        elif request.what is CalibrationKind.GEOMETRY:
            values = (fits.check_gauges([each * 1e-3 for each in request.values]) * 1e3).tolist()
        self._request, self._rest_readings, self._motion_readings = request, [], []
        self.state = NO_CALIBRATION.model_copy(update={"what": request.what, "values": values})

    def discard(self) -> None:
        """Discard the measurements so far.

        Raises:
            RefusedError: a reading is under way; a stop ends it.
        """
        self._check_idle()
        self._request = None
        self.state = NO_CALIBRATION

    def _check_idle(self) -> None:
        if self.state.reading:
            raise RefusedError("A reading is under way. Wait for it, or press STOP.")
        if self._is_changing_tool:
            raise RefusedError("Another tool file is being put to use. Try again in a few seconds.")

    async def use_tool_file(self, path: Path, by: str | None) -> None:
        """Let the tool and the next calibration go on with the constants of a tool file.

        Raises:
            RefusedError: a calibration or a run is under way, or the file is of another tool.
            ConfigurationError: the file has faults, or the library does not fit its constants.
        """
        self._check_idle()
        if self._request and not self.state.result:
            raise RefusedError("A calibration is under way. Finish it, or discard it first.")
        self._is_changing_tool = True
        try:
            await self._tool_service.use_tool_file(path, by)
        finally:
            self._is_changing_tool = False
        self._newest_file = None

    async def take_reading(self, by: str | None) -> None:
        """Take the next reading; after the last one, fit the constants and write the tool file.

        Raises:
            RefusedError: no calibration was begun, all readings are taken, or the tool may not move now.
            ServiceError: the acquisition does not answer, or no samples arrive.
            CalibrationError: the reading cannot be trusted and may be repeated, or the fit cannot be trusted.
        """
        self._check_idle()
        if self._request is None or self._reading_count == len(self.state.values):
            raise RefusedError("Nothing is left to read: begin a calibration.")
        self._tool_service.check_ready()
        request, value = self._request, self.state.values[self._reading_count]
        self._update_state(reading=True, problem=None)
        try:
            found = await self._measure(request.what, value, by)
            if isinstance(found, RawSignals):
                self._rest_readings.append(found)
            else:
                self._motion_readings.append(found)
            self._update_state(readings=[*self.state.readings, _summarize_reading(value, found)])
            if self._reading_count == len(self.state.values):
                await self._finish(request, by)
        finally:
            self._collected_blocks = None
            self._update_state(reading=False)

    @property
    def _reading_count(self) -> int:
        return len(self._rest_readings) + len(self._motion_readings)

    async def _measure(self, what: CalibrationKind, value: float, by: str | None) -> RawSignals | list[ForcePass]:
        try:
            if what not in REST_DURATIONS_S:
                return await self._measure_in_motion(what, value, by)
            found = await self._measure_at_rest(what, value, by)
            if what in (CalibrationKind.STRAIN, CalibrationKind.FORCE):
                fits.check_steady(found, f"{value:g} N", self._load_newest_tool())
        except CalibrationError as error:
            self._update_state(problem=str(error))
            raise
        return found

    def _update_state(self, **changes: object) -> None:
        self.state = self.state.model_copy(update=changes)

    def _load_newest_tool(self) -> Tool:
        return load_tool(self.tool_source)

    async def _measure_at_rest(self, what: CalibrationKind, value: float, by: str | None) -> RawSignals:
        if (
            self._tool_service.arming.safety is Safety.ARMED
        ):  # an armed tool would take the weight for a fault of its gage
            await self._tool_service.arming.disarm(by)
        pull_n = {
            CalibrationKind.STRAIN: value,
            CalibrationKind.FORCE: calibration_bench.compute_handle_pull(self._plan.tool, value),
        }.get(what, 0.0)
        await self._set_simulated_load(pull_n, None)
        try:
            seconds = REST_DURATIONS_S[what]
            self._collected_blocks, wanted = [], round(seconds * self._plan.tool.board.sample_rate_hz)
            async with asyncio.timeout(seconds + SAMPLE_TIMEOUT_S):
                while sum(len(block.samples) for block in _drop_late_blocks(self._collected_blocks)) < wanted:
                    self._block_arrived.clear()
                    await self._block_arrived.wait()
        except TimeoutError:
            raise ServiceError("No samples arrive from the tool. See the alarms, then read again.") from None
        finally:
            taken, self._collected_blocks = self._collected_blocks or [], None
            await self._set_simulated_load(0.0, None)
        return calibration_bench.extract_signals(_drop_late_blocks(taken))

    async def _measure_in_motion(self, what: CalibrationKind, value: float, by: str | None) -> list[ForcePass]:
        await self._set_simulated_load(0.0, value * 1e-3 if what is CalibrationKind.GEOMETRY else 0.0)
        try:
            self._collected_blocks = []
            run = await self._tool_service.run_controller.start(
                calibration_bench.build_closing_protocol(), 1, None, by, self._unmeasured_scale_reason
            )
            while self._tool_service.runs.current and self._tool_service.runs.current.id == run.id:
                self._block_arrived.clear()
                await asyncio.wait_for(self._block_arrived.wait(), SAMPLE_TIMEOUT_S)
            ended = self._tool_service.runs.get(run.id) or run
            if ended.state.value != "finished":
                raise CalibrationError(f"The run was {ended.state.value}: {ended.why}. Mend that, and read again.")
        except TimeoutError:
            raise ServiceError("No samples arrive from the tool. See the alarms, then read again.") from None
        finally:
            taken, self._collected_blocks = self._collected_blocks or [], None
            await self._set_simulated_load(0.0, None)
            arming = self._tool_service.arming
            if arming.safety is Safety.ARMED and arming.unmeasured_scale_reason == CALIBRATION_ARM_REASON:
                await arming.disarm(by)  # it was armed for this reading alone
        played = calibration_bench.extract_signals([block for block in taken if block.run == run.id])
        return calibration_bench.extract_force_passes(played, self._load_newest_tool())

    async def _set_simulated_load(self, pull_n: float, gauge_m: float | None) -> None:
        """Load the simulated tool as a person loads a real one: a pull on the handle, or a gauge block in the jaws."""
        if self._plan.tool.kind is ToolKind.SIMULATED:
            await self._tool_service.commander.send(bus.SimulatedPullAndGaugeCommand(pull_n, gauge_m))

    async def _finish(self, request: CalibrationRequest, by: str | None) -> None:
        """Fit in a thread, as the first fit loads slow modules, then write the tool file; a failure sets `problem`."""
        tool = self._load_newest_tool()
        person = request.person or by or computer_user_name()
        try:
            fit = await asyncio.to_thread(self._fit, request, tool)
        except CalibrationError as error:
            self._update_state(problem=f"{error} Nothing was written.")
            raise
        path = await asyncio.to_thread(
            write_calibration_file, fit, self.tool_source, person, request.valid_days, self._folder
        )
        self._newest_file = str(path)
        self._update_state(result=_build_result(fit, tool, path))
        names = ", ".join(each.key for each in fit.constants)
        self._tool_service.publisher.publish_event(f"Calibrated: {names}; written to {path}", by=by)

    @property
    def _unmeasured_scale_reason(self) -> str:
        """Why the tool may move without a measured force scale; empty if it has one."""
        return "" if self._plan.tool.has_known_scale else CALIBRATION_ARM_REASON

    @property
    def _folder(self) -> Path:
        return self._plan.data_folder / "tools"

    def _fit(self, request: CalibrationRequest, tool: Tool) -> CalibrationFit:
        match request.what:
            case CalibrationKind.TARE:
                return fits.fit_tare(self._rest_readings[0], tool)
            case CalibrationKind.STRAIN:
                return fits.fit_strain(self.state.values, self._rest_readings, tool)
            case CalibrationKind.FORCE:
                return fits.fit_force_scale(self.state.values, self._rest_readings, tool, request.load_cell_error)
            case CalibrationKind.STRETCH:
                return fits.fit_cable_stretch(self._motion_readings[0], tool)
            case CalibrationKind.GEOMETRY:
                passes = [calibration_bench.merge_passes(found) for found in self._motion_readings]
                return fits.fit_geometry([each * 1e-3 for each in self.state.values], passes, tool)


def _drop_late_blocks(blocks: list[SampleBlock]) -> list[SampleBlock]:
    """Return the blocks after the first one that was read in time: those up to it may be of before the reading."""
    return list(dropwhile(lambda block: block.backlog >= len(block.samples), blocks))[1:]


def _summarize_reading(value: float, found: RawSignals | list[ForcePass]) -> CalibrationReading:
    signals = found if isinstance(found, RawSignals) else calibration_bench.merge_passes(found)
    return CalibrationReading(
        value=value, strain_v=float(signals.strain_v.mean()), encoder_deg=float(signals.encoder_deg.mean())
    )


def _build_result(fit: CalibrationFit, tool: Tool, path: Path) -> CalibrationResult:
    thin = slice(None, None, max(1, len(fit.points[0]) // MAX_PLOT_POINTS))
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
            before=fits.read_current_value(each, tool),
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
