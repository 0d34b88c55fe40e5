"""An example of each body of the REST interface, for its description and for the programs that are made from it."""

from pydantic import BaseModel

from acquisition.safety_state_machine import Safety
from app.messages.alarms import AcknowledgeRequest, Alarm, AlarmKind
from app.messages.annotations import (
    GraspRemark,
    GraspTruth,
    Mark,
    MarkChange,
    MarkRequest,
    TruthCorrection,
    TruthRequest,
    TruthStatement,
)
from app.messages.calibration import Calibration, CalibrationKind, CalibrationReading, CalibrationRequest
from app.messages.grasps import Grasp, GraspEnded
from app.messages.journal import JournalCheck, JournalEntry, JournalKind
from app.messages.lab_sessions import LabSession, LabSessionChange, LabSessionRequest, SpecimenCondition
from app.messages.live import NO_REFERENCE
from app.messages.named_files import (
    ApprovalRequest,
    ColumnSummary,
    FileCheck,
    FileContent,
    FileList,
    FileRequest,
    FileText,
    LibraryApproval,
    LibraryVersion,
    NamedFile,
    RestoreRequest,
    TimeColumnGuess,
    ToolDraftReport,
)
from app.messages.people import ControlInfo, ControlRequest, Role, SessionInfo, SignIn
from app.messages.recordings import (
    BinContent,
    BinnedRecording,
    Emptied,
    FileCondition,
    FileRecord,
    RecordingInfo,
    Recordings,
    ReportProgress,
)
from app.messages.runs import DeclineRequest, Run, RunRequest, RunState, SpotRequest, StopAnswer, StopRequest
from app.messages.studies import Studies, StudyInfo, StudyRequest, StudyRun, StudyState
from app.messages.system import Health, Problem, System
from app.messages.tool import (
    ArmRequest,
    ConstantInfo,
    ForceScaleInfo,
    LibraryInfo,
    ProtocolInfo,
    SafetyReport,
    SpreadInfo,
    TissueInfo,
    ToolInfo,
)
from app.service.runs import RunUnderWayError
from config.load import FileKind
from config.schema import ToolKind
from estimator.force_alarms import Priority

_BEGAN_MS = 1_764_500_523_412.0
_RUN = Run(
    id="20261130-110203-7f3a-001",
    protocol="trapezoid_2hz",
    cycles=3,
    tissue="liver",
    by="Ada",
    state=RunState.RUNNING,
    started_at="2026-11-30T11:02:03.412000+00:00",
    ended_at=None,
    why=None,
    grasps=0,
)
_GRASP = Grasp(
    index=1,
    start_s=312.4,
    contact_s=312.61,
    end_s=313.9,
    label="liver",
    probability=0.98,
    probabilities={"liver": 0.98, "small_bowel": 0.02},
    time_to_decision_s=0.21,
    alpha_n=0.31,
    beta_per_m=412.0,
    damping_kg_per_s=2.4,
    peak_force_n=1.55,
    peak_displacement_m=0.0061,
    convergence_s={"liver": 0.12, "small_bowel": None},
    force_error_n={"liver": 0.02, "small_bowel": 0.4},
    valid=True,
    why_invalid=None,
    alarms=[Priority.LOW],
    held_back=False,
    peak_share_of_limit=0.71,
)
_ALARM = Alarm(
    id="force-3",
    kind=AlarmKind.FORCE,
    priority=Priority.MEDIUM,
    active=True,
    latched=False,
    text="The force is near the injury threshold of liver",
    value=1.9,
    limit=2.2,
    unit="N",
    began_ms=_BEGAN_MS,
    ended_ms=None,
    acknowledged_by=None,
)
_FORCE_SCALE = ForceScaleInfo(
    value=1.0,
    low=0.95,
    high=1.05,
    measured=True,
    source="gauge between the jaws",
    date="2026-11-02",
    expires="2027-01-31",
    text="force scale 1.00 (0.95 to 1.05), measured 2026-11-02",
)
_FILE = FileRecord(
    name=f"{_RUN.id}.mcap",
    run_id=_RUN.id,
    size_bytes=912_384,
    made_at="2026-11-30T11:02:09+00:00",
    duration_s=9.5,
    samples=9_500,
    lost_samples=0,
    format_version="3",
    condition=FileCondition.COMPLETE,
    problem=None,
)
_STUDY = StudyRun(
    id="20261130-101500-identify",
    study="identify",
    title="How right, how early, how honest",
    grasps=250,
    seed=7,
    by="Ada",
    state=StudyState.RUNNING,
    done=12,
    of=40,
    started_at="2026-11-30T10:15:00+00:00",
    ended_at=None,
    why=None,
    report=None,
)

_PROTOCOL = ProtocolInfo(
    name="trapezoid_2hz",
    title="Trapezoid, 2 Hz",
    cycles=3,
    cycle_s=0.5,
    peak_command_v=2.0,
    refused=None,
    time_s=[0.0, 0.1, 0.2, 0.4],
    command_v=[0.0, 2.0, 2.0, 0.0],
)
_PROTOCOL_FILE = NamedFile(
    kind=FileKind.PROTOCOL, name="hold_3s", title="Hold for 3 s", shipped=False, problems=[], in_use=None
)
_PROTOCOL_TEXT = """name = "hold_3s"
title = "Hold for 3 s"

[waveform]
shape = "trapezoid"
peak_v = 1.0
ramp_up_s = 0.5
hold_s = 3.0
ramp_down_s = 0.5
rest_s = 1.0
"""

_VERSION = "b1f04c6a7d2e9380"
_APPROVAL = LibraryApproval(
    sha256=f"{_VERSION}1f8e5b7c4a90d263{_VERSION}1f8e5b7c4a90d263",
    library="ward_3",
    approved=True,
    reason="judged on 40 spots of 5 animals",
    by="Ada",
    at="2026-12-01T10:05:00+00:00",
)

EXAMPLES: dict[str, BaseModel] = {
    type(each).__name__: each
    for each in (
        RunRequest(protocol="trapezoid_2hz", cycles=3, tissue="liver", by="Ada"),
        ArmRequest(by="Ada"),
        StopRequest(by="Ada"),
        SpotRequest(by="Ada"),
        DeclineRequest(by="Ada"),
        TruthRequest(held="liver", by="Ada"),
        TruthCorrection(held="gallbladder", remark=GraspRemark.SLIPPED, version=1, why="seen on the video", by="Ada"),
        MarkRequest(text="irrigation on", by="Ada"),
        MarkChange(text="irrigation off", version=1, by="Ada"),
        LabSessionRequest(subject="P-12", species="pig", condition=SpecimenCondition.IN_VIVO, operator="Ada"),
        LabSessionChange(
            subject="P-12", species="pig", condition=SpecimenCondition.EX_VIVO, operator="Ada", version=1, by="Ada"
        ),
        AcknowledgeRequest(by="Ada", priority=Priority.MEDIUM),
        _APPROVAL,
        LibraryVersion(version=_VERSION, saved_at="2026-12-01T10:00:00+00:00", current=True, approval=_APPROVAL),
        ApprovalRequest(version=_VERSION, reason="judged on 40 spots of 5 animals", by="Ada"),
        RestoreRequest(version=_VERSION, replaces="5ff1a0c2e9d37b64", by="Ada"),
        FileText(text=_PROTOCOL_TEXT),
        FileRequest(text=_PROTOCOL_TEXT, by="Ada"),
        FileList(folder="/var/lib/graspwatch", files=[_PROTOCOL_FILE]),
        FileCheck(problems=[], name="hold_3s", protocol=_PROTOCOL, library=None),
        ToolDraftReport(
            columns=[ColumnSummary(number=2, name="force", low=0.0, high=302.5, means=[0.1, 151.0, 0.2])],
            times=TimeColumnGuess(column=1, unit="ms", rate_hz=370.0),
            text=None,
            assumed=[],
            grasps=0,
            first_grasps=[],
        ),
        FileContent(
            problems=[],
            name="hold_3s",
            protocol=_PROTOCOL,
            library=None,
            file=_PROTOCOL_FILE,
            text=_PROTOCOL_TEXT,
            version="b1f04c6a7d2e9380",
        ),
        CalibrationRequest(what=CalibrationKind.STRAIN, values=[0.0, 5.0, 10.0], person="Ada"),
        ControlRequest(take_over=True),
        SignIn(token="the-token-that-graspwatch-token-add-printed"),
        StudyRequest(study="identify", grasps=250, seed=7, by="Ada"),
        Problem(title="Conflict", status=409, detail=str(RunUnderWayError(_RUN)), run=_RUN),
        _RUN,
        _GRASP,
        _ALARM,
        _FILE,
        _STUDY,
        GraspEnded(run_id=_RUN.id, grasp=_GRASP),
        TruthStatement(held="liver", remark=None, by="Ada"),
        LabSession(
            id="S20261130-090000",
            subject="P-12",
            species="pig",
            specimen=None,
            condition=SpecimenCondition.IN_VIVO,
            operator="Ada",
            protocol_number="2026-017",
            notes=None,
            fields={},
            began_at="2026-11-30T09:00:00+00:00",
            ended_at=None,
            version=1,
            by="Ada",
        ),
        GraspTruth(
            run_id=_RUN.id,
            grasp=1,
            held="liver",
            remark=None,
            version=1,
            by="Ada",
            at="2026-11-30T11:02:05.100000+00:00",
            why=None,
        ),
        Mark(
            id=f"{_RUN.id}-mark1",
            run_id=_RUN.id,
            at_s=12.345,
            at_ms=_BEGAN_MS,
            uncertainty_s=0.04,
            text="irrigation on",
            version=1,
            by="Ada",
            changed_at="2026-11-30T11:02:05.140000+00:00",
        ),
        StopAnswer(stopped=True, run=_RUN.model_copy(update={"state": RunState.STOPPED})),
        SafetyReport(safety=Safety.ARMED),
        NO_REFERENCE.model_copy(update={"declined": True}),
        ControlInfo(holder="Ada", expires_in_s=287.0),
        SessionInfo(needed=True, name="Ada", role=Role.OPERATOR),
        Calibration(
            what=CalibrationKind.STRAIN,
            values=[0.0, 5.0, 10.0],
            readings=[CalibrationReading(value=0.0, strain_v=0.012, encoder_deg=0.3)],
            reading=False,
            problem=None,
            result=None,
        ),
        JournalEntry(
            at=_RUN.started_at,
            kind=JournalKind.RUN,
            text="Run started: Trapezoid, 2 Hz, 3 grasps, liver",
            by="Ada",
            run=_RUN,
        ),
        JournalCheck(
            whole=True,
            problem=None,
            notes=[],
            lines=128,
            unchained=0,
            newest=128,
            newest_hash="9f2c1d7ab0e4",
            checked_at="2026-11-30T11:05:00+00:00",
        ),
        Health(
            status="ready",
            version="0.1.0",
            workers={"acquisition": "running", "estimator": "running", "recorder": "running"},
            detail="idle",
        ),
        ToolInfo(
            name="simulated",
            title="Simulated grasper",
            kind=ToolKind.SIMULATED,
            sample_rate_hz=1000.0,
            max_command_v=5.0,
            force_ceiling_n=10.0,
            force_scale=_FORCE_SCALE,
            calibration_date="2026-11-02",
            calibrated_by="Ada",
        ),
        _PROTOCOL,
        LibraryInfo(
            name="porcine",
            title="Porcine abdominal tissues",
            source="the paper's Table II",
            mass_kg=0.1,
            jaw_area_m2=9e-5,
            tissues=[
                TissueInfo(
                    name="liver",
                    title="Liver",
                    alpha_n=0.31,
                    beta_per_m=412.0,
                    damping_kg_per_s=2.4,
                    thickness_m=0.012,
                    threshold_n=2.2,
                    threshold_pa=24_000.0,
                    spread=SpreadInfo(log_alpha=0.2, log_beta=0.1, log_damping=0.3, log_thickness=0.2),
                )
            ],
        ),
        System(
            versions={"graspwatch": "0.1.0", "python": "3.11.9"},
            machine="Linux 6.1, x86_64, 4 cores",
            started_at="2026-11-30T09:00:00+00:00",
            workers={"acquisition": "running"},
            realtime={"acquisition": "SCHED_FIFO 80"},
            data_folder="/var/lib/graspwatch",
            free_disk_bytes=120_000_000_000,
            tool={"name": "simulated"},
            constants=[
                ConstantInfo(
                    constant="jaw_force_scale",
                    value=1.0,
                    date="2026-11-02",
                    by="Ada",
                    expires="2027-01-31",
                    expired=False,
                )
            ],
            force_scale=_FORCE_SCALE,
            settings={"server": {"frame_rate_hz": 30}},
        ),
        Recordings(
            folder="/var/lib/graspwatch/recordings",
            recordings=[
                RecordingInfo(
                    name=_FILE.name,
                    size_bytes=_FILE.size_bytes,
                    modified_at=_FILE.made_at,
                    recorded_at=_FILE.made_at,
                    duration_s=9.5,
                    problem=None,
                    whole=True,
                    run_id=_RUN.id,
                    protocol="trapezoid_2hz",
                    tissue="liver",
                    by="Ada",
                    subject="P-12",
                    labels=["liver", "undecided", "liver"],
                    held=["liver"],
                )
            ],
        ),
        BinContent(
            recordings=[
                BinnedRecording(
                    entry=f"1-{_FILE.name}",
                    name=_FILE.name,
                    size_bytes=_FILE.size_bytes,
                    deleted_at="2026-11-30T12:00:00+00:00",
                    deleted_by="Ada",
                    expires_at="2026-12-30T12:00:00+00:00",
                )
            ],
            size_bytes=_FILE.size_bytes,
            keep_days=30,
        ),
        Emptied(removed=3, freed_bytes=2_737_152),
        ReportProgress(done=0.4),
        Studies(
            folder="/var/lib/graspwatch/studies",
            available=[
                StudyInfo(name="identify", title="How right, how early, how honest", grasps=250, most_grasps=10_000)
            ],
            runs=[_STUDY],
        ),
    )
}
"""By the name of the body's model."""
