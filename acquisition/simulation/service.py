"""The simulated board behind nidaqmx's own gRPC interface: in this process without a socket, or over TCP."""

import functools
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, NoReturn

import grpc
import nidaqmx
from nidaqmx._stubs import nidaqmx_pb2 as pb
from nidaqmx._stubs.nidaqmx_pb2_grpc import NiDAQmxServicer, add_NiDAQmxServicer_to_server
from nidaqmx.constants import EncoderType
from nidaqmx.error_codes import DAQmxErrors

from acquisition.simulation.board import BoardError, ChannelKind, SimulatedBoard

_DRIVER_VERSION = {0x1272: 24, 0x1923: 8, 0x2F22: 0}  # attributes of the system: major, minor, update
_ARM_START_SOURCE = 0x1417
_TASK_CHANNELS = 0x1273
_CHANNEL_ATTRIBUTES: dict[int, ChannelKind] = {
    pb.DEVICE_ATTRIBUTE_AI_PHYSICAL_CHANS: ChannelKind.ANALOG_IN,
    pb.DEVICE_ATTRIBUTE_AO_PHYSICAL_CHANS: ChannelKind.ANALOG_OUT,
    pb.DEVICE_ATTRIBUTE_CI_PHYSICAL_CHANS: ChannelKind.ENCODER,
}
_INPUT_RANGES_V = (-0.2, 0.2, -1.0, 1.0, -5.0, 5.0, -10.0, 10.0)  # of a PCI-6230
_COUNTS_PER_PULSE = {EncoderType.X_1.value: 1, EncoderType.X_2.value: 2, EncoderType.X_4.value: 4}


def create_in_process_options(board: SimulatedBoard) -> nidaqmx.GrpcSessionOptions:
    """Return the session options with which nidaqmx or `NidaqSource` reaches `board` by plain function calls."""
    service = BoardService(board)  # pyright: ignore[reportAbstractUsage]  only the stub calls the base class abstract
    return nidaqmx.GrpcSessionOptions(InProcessGrpcChannel(service), "")


def serve_tcp(
    board: SimulatedBoard, address: str = "127.0.0.1:0", credentials: grpc.ServerCredentials | None = None
) -> tuple[grpc.Server, int]:
    """Serve a simulated board by gRPC at `address`, encrypted with `credentials`; return the server and its port.

    Raises:
        RuntimeError: the address is taken.
    """
    server = grpc.server(ThreadPoolExecutor(max_workers=4, thread_name_prefix="simulated-board"))
    service = BoardService(board)  # pyright: ignore[reportAbstractUsage]  only the stub calls the base class abstract
    add_NiDAQmxServicer_to_server(service, server)
    port = server.add_secure_port(address, credentials) if credentials else server.add_insecure_port(address)
    server.start()
    return server, port


def _convert_board_errors(method: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    """Convert a BoardError to the status and metadata in which nidaqmx looks for the error code."""

    @functools.wraps(method)
    def answer(service: Any, request: Any, context: Any) -> Any:
        try:
            return method(service, request)
        except BoardError as error:
            context.set_trailing_metadata((("ni-error", str(int(error.code))),))
            context.abort(grpc.StatusCode.UNKNOWN, str(error))

    return answer


class BoardService(NiDAQmxServicer):
    """The DAQmx calls that the driver needs; the base class answers any other with UNIMPLEMENTED."""

    def __init__(self, board: SimulatedBoard) -> None:
        self._board = board

    @_convert_board_errors
    def GetSystemInfoAttributeUInt32(
        self, request: pb.GetSystemInfoAttributeUInt32Request
    ) -> pb.GetSystemInfoAttributeUInt32Response:
        return pb.GetSystemInfoAttributeUInt32Response(value=_DRIVER_VERSION.get(request.attribute_raw, 0))

    @_convert_board_errors
    def GetDeviceAttributeString(
        self, request: pb.GetDeviceAttributeStringRequest
    ) -> pb.GetDeviceAttributeStringResponse:
        self._board.check_device(request.device_name)
        kind = _CHANNEL_ATTRIBUTES.get(request.attribute_raw)
        channels = (
            ", ".join(f"{request.device_name}/{each}" for each in self._board.channel_names(kind)) if kind else ""
        )
        return pb.GetDeviceAttributeStringResponse(value=channels or self._board.product)

    @_convert_board_errors
    def GetDeviceAttributeDoubleArray(
        self, request: pb.GetDeviceAttributeDoubleArrayRequest
    ) -> pb.GetDeviceAttributeDoubleArrayResponse:
        self._board.check_device(request.device_name)
        return pb.GetDeviceAttributeDoubleArrayResponse(value=_INPUT_RANGES_V)

    @_convert_board_errors
    def CreateTask(self, request: pb.CreateTaskRequest) -> pb.CreateTaskResponse:
        response = pb.CreateTaskResponse(new_session_initialized=True)
        response.task.name = self._board.create_task(request.session_name)
        return response

    @_convert_board_errors
    def GetTaskAttributeString(self, request: pb.GetTaskAttributeStringRequest) -> pb.GetTaskAttributeStringResponse:
        task = self._board.task(request.task.name)
        value = ", ".join(task.channels) if request.attribute_raw == _TASK_CHANNELS else task.name
        return pb.GetTaskAttributeStringResponse(value=value)

    @_convert_board_errors
    def GetReadAttributeUInt32(self, request: pb.GetReadAttributeUInt32Request) -> pb.GetReadAttributeUInt32Response:
        return pb.GetReadAttributeUInt32Response(value=len(self._board.task(request.task.name).channels))

    @_convert_board_errors
    def GetReadAttributeUInt64(self, request: pb.GetReadAttributeUInt64Request) -> pb.GetReadAttributeUInt64Response:
        return pb.GetReadAttributeUInt64Response(
            value=self._board.count_acquired_samples(request.task.name)
        )  # the driver asks for no other attribute

    @_convert_board_errors
    def CreateAIVoltageChan(self, request: pb.CreateAIVoltageChanRequest) -> pb.CreateAIVoltageChanResponse:
        self._board.add_channel_to_task(request.task.name, ChannelKind.ANALOG_IN, request.physical_channel)
        return pb.CreateAIVoltageChanResponse()

    @_convert_board_errors
    def CreateAOVoltageChan(self, request: pb.CreateAOVoltageChanRequest) -> pb.CreateAOVoltageChanResponse:
        task = self._board.add_channel_to_task(request.task.name, ChannelKind.ANALOG_OUT, request.physical_channel)
        task.output_range_v = (request.min_val, request.max_val)
        return pb.CreateAOVoltageChanResponse()

    @_convert_board_errors
    def CreateCIAngEncoderChan(self, request: pb.CreateCIAngEncoderChanRequest) -> pb.CreateCIAngEncoderChanResponse:
        task = self._board.add_channel_to_task(request.task.name, ChannelKind.ENCODER, request.counter)
        counts_per_turn = request.pulses_per_rev * _COUNTS_PER_PULSE[request.decoding_type_raw]
        task.degrees_per_count = 360.0 / counts_per_turn
        return pb.CreateCIAngEncoderChanResponse()

    @_convert_board_errors
    def CfgSampClkTiming(self, request: pb.CfgSampClkTimingRequest) -> pb.CfgSampClkTimingResponse:
        self._board.configure_sample_clock_timing(request.task.name, request.rate, request.source)
        return pb.CfgSampClkTimingResponse()

    @_convert_board_errors
    def GetTimingAttributeDouble(
        self, request: pb.GetTimingAttributeDoubleRequest
    ) -> pb.GetTimingAttributeDoubleResponse:
        return pb.GetTimingAttributeDoubleResponse(
            value=self._board.task(request.task.name).rate_hz
        )  # the driver asks for no other attribute

    @_convert_board_errors
    def SetTrigAttributeInt32(self, request: pb.SetTrigAttributeInt32Request) -> pb.SetTrigAttributeInt32Response:
        return pb.SetTrigAttributeInt32Response()  # kind and edge of the trigger: there is only one of each here

    @_convert_board_errors
    def SetTrigAttributeString(self, request: pb.SetTrigAttributeStringRequest) -> pb.SetTrigAttributeStringResponse:
        if request.attribute_raw == _ARM_START_SOURCE:
            self._board.task(request.task.name).arm_trigger = request.value
        return pb.SetTrigAttributeStringResponse()

    @_convert_board_errors
    def StartTask(self, request: pb.StartTaskRequest) -> pb.StartTaskResponse:
        self._board.start_task(request.task.name)
        return pb.StartTaskResponse()

    @_convert_board_errors
    def StopTask(self, request: pb.StopTaskRequest) -> pb.StopTaskResponse:
        self._board.stop_task(request.task.name)
        return pb.StopTaskResponse()

    @_convert_board_errors
    def ClearTask(self, request: pb.ClearTaskRequest) -> pb.ClearTaskResponse:
        self._board.clear_task(request.task.name)
        return pb.ClearTaskResponse()

    @_convert_board_errors
    def ResetDevice(self, request: pb.ResetDeviceRequest) -> pb.ResetDeviceResponse:
        self._board.reset_device(request.device_name)
        return pb.ResetDeviceResponse()

    @_convert_board_errors
    def ReadAnalogF64(self, request: pb.ReadAnalogF64Request) -> pb.ReadAnalogF64Response:
        wanted = request.num_samps_per_chan
        values, got = self._board.read_analog(request.task.name, wanted, request.timeout)
        return pb.ReadAnalogF64Response(read_array=values, samps_per_chan_read=got, status=_read_status(got, wanted))

    @_convert_board_errors
    def ReadCounterF64Ex(self, request: pb.ReadCounterF64ExRequest) -> pb.ReadCounterF64ExResponse:
        wanted = request.num_samps_per_chan
        values, got = self._board.read_encoder(request.task.name, wanted, request.timeout)
        return pb.ReadCounterF64ExResponse(read_array=values, samps_per_chan_read=got, status=_read_status(got, wanted))

    @_convert_board_errors
    def WriteAnalogScalarF64(self, request: pb.WriteAnalogScalarF64Request) -> pb.WriteAnalogScalarF64Response:
        self._board.write_output(request.task.name, request.value, request.auto_start)
        return pb.WriteAnalogScalarF64Response()


def _read_status(got: int, wanted: int) -> int:
    """Return the status of a read. A time-out is no gRPC error, because it delivers the samples that did come."""
    return 0 if got == wanted else DAQmxErrors.SAMPLES_NOT_YET_AVAILABLE


class _Metadatum(NamedTuple):
    key: str
    value: str


class InProcessGrpcError(grpc.RpcError):
    """The in-process counterpart of a socket's `grpc.RpcError`: status, text and trailing metadata."""

    def __init__(self, status: grpc.StatusCode, text: str, metadata: tuple[_Metadatum, ...] = ()) -> None:
        super().__init__(text)
        self._status, self._text, self._metadata = status, text, metadata

    def code(self) -> grpc.StatusCode:
        return self._status

    def details(self) -> str:
        return self._text

    def trailing_metadata(self) -> tuple[Any, ...]:  # of the stub's type, which grpc itself does not have
        return self._metadata


class _InProcessContext:
    """The part of `grpc.ServicerContext` that `_convert_board_errors` uses."""

    _metadata: tuple[_Metadatum, ...] = ()

    def set_trailing_metadata(self, metadata: Iterable[tuple[str, str]]) -> None:
        self._metadata = tuple(_Metadatum(*pair) for pair in metadata)

    def abort(self, status: grpc.StatusCode, text: str) -> NoReturn:
        raise InProcessGrpcError(status, text, self._metadata)


class InProcessGrpcChannel(grpc.Channel):
    """A channel that calls the service's methods with the request objects: no socket, thread or serialization."""

    def __init__(self, service: BoardService) -> None:
        self._service = service

    def unary_unary(self, method: str, *_: Any, **__: Any) -> Any:
        """Return a function that calls the method, in place of grpc's own callable class."""
        name = method.rpartition("/")[2]
        call = getattr(self._service, name) if name in vars(BoardService) else None

        def invoke(request: Any, timeout: float | None = None, metadata: Any = None) -> Any:
            if call is None:
                raise InProcessGrpcError(grpc.StatusCode.UNIMPLEMENTED, f"The simulated board does not know {name}.")
            return call(request, _InProcessContext())

        return invoke

    def unary_stream(self, method: str, *_: Any, **__: Any) -> Any:
        return self.unary_unary(method)  # streams carry DAQmx events, none of which the service has

    stream_unary = stream_stream = unary_stream

    def subscribe(self, callback: Any, try_to_connect: bool | None = False) -> None:
        """Do nothing: the state of an in-process connection never changes."""

    def unsubscribe(self, callback: Any) -> None:
        """Do nothing: there are no subscriptions in this process."""

    def close(self) -> None:
        """Do nothing: an in-process channel holds no connection."""

    def __enter__(self) -> "InProcessGrpcChannel":
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()
