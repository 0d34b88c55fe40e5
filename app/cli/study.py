"""`graspwatch study`: how accurate, early and well calibrated the estimator is, as a page and a JSON."""

import time
from collections.abc import Callable
from datetime import date
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from app.cli.console import error_console, print_note
from app.cli.label_option import LABEL_HELP, LABEL_METAVAR, LabelCommand, parse_labels_of
from app.cli.options import DataOption, ProgressBar, explain_write_errors, locate_data_folder
from app.cli.study_output import print_study
from config.atomic_write import check_writable
from config.errors import ConfigurationError
from config.load import (
    FileKind,
    find_file,
    list_shipped_names,
    load_grasp_protocol,
    load_library,
    load_settings,
    load_tool,
)
from estimator.studies.catalog import MAX_GRASPS, STUDIES, StudyDefinition

if TYPE_CHECKING:
    from estimator.studies.answer_course import StudyConditions

app = typer.Typer(
    help="Measure how right, how early and how honest the estimator is. Each study writes a self-contained HTML page "
    "and a JSON of every figure, and uses all cores.",
    no_args_is_help=True,
)
ESTIMATE_AFTER_SHARE, ESTIMATE_AFTER_S = (
    0.05,
    1.0,
)  # share of cases and seconds before the one-line estimate of the time left
DEFAULT_FOLDER = Path("studies")

GraspsOption = Annotated[
    int, typer.Option(min=1, max=MAX_GRASPS, help="Grasps of each tissue (and of each condition).")
]
SeedOption = Annotated[int, typer.Option(min=0, help="Of specimens, noise and guesses.")]
NoiseOption = Annotated[
    float, typer.Option(min=0.05, max=100, help="Noise of the strain gage, mV; known to the estimator.")
]
SpreadOption = Annotated[float, typer.Option(min=0, max=5, help="Scatter of specimens, times the library's spreads.")]
ProtocolOption = Annotated[str, typer.Option(metavar="NAME|FILE", help="What the motor is commanded.")]
LibraryOption = Annotated[str, typer.Option(metavar="NAME|FILE", help="Tissue library.")]
TouchOption = Annotated[bool, typer.Option("--touch/--no-touch", help="Whether the tool senses contact.")]
ThicknessOption = Annotated[
    bool, typer.Option("--thickness/--no-thickness", help="Whether thickness at contact is evidence.")
]
OutOption = Annotated[Path, typer.Option(metavar="FOLDER", help="Where the page and the JSON are written.")]
JobsOption = Annotated[int | None, typer.Option(min=1, help="Processes; default: one a core.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the JSON instead of a table.")]


def _make_seeds_command(study: StudyDefinition) -> Callable[..., None]:
    def command(
        seeds: Annotated[
            int, typer.Option(min=1, max=study.max_count, help="Noises and wrong guesses of each tissue.")
        ] = study.default_count,
        seed: SeedOption = 0,
        out: OutOption = DEFAULT_FOLDER,
        jobs: JobsOption = None,
        as_json: JsonOption = False,
    ) -> None:
        from estimator.studies.answer_course import StudyConditions  # a slow import

        _run_study(study, StudyConditions(), seeds, seed, out, jobs, as_json)

    return command


def _make_thickness_command(study: StudyDefinition) -> Callable[..., None]:
    def command(
        grasps: GraspsOption = study.default_count,
        noise_mv: NoiseOption = 2.0,
        spread: SpreadOption = 1.0,
        protocol: ProtocolOption = "trapezoid_2hz",
        library: LibraryOption = "porcine",
        data: DataOption = None,
        touch: TouchOption = True,
        thickness: ThicknessOption = True,
        seed: SeedOption = 0,
        out: OutOption = DEFAULT_FOLDER,
        jobs: JobsOption = None,
        as_json: JsonOption = False,
    ) -> None:
        bench = _make_bench(data, protocol, library, noise_mv, spread, touch, thickness)
        _run_study(study, bench, grasps, seed, out, jobs, as_json)

    return command


def _make_protocol_command(study: StudyDefinition) -> Callable[..., None]:
    def command(
        grasps: GraspsOption = study.default_count,
        noise_mv: NoiseOption = 2.0,
        spread: SpreadOption = 1.0,
        protocol: ProtocolOption = "trapezoid_2hz",
        library: LibraryOption = "porcine",
        data: DataOption = None,
        touch: TouchOption = True,
        seed: SeedOption = 0,
        out: OutOption = DEFAULT_FOLDER,
        jobs: JobsOption = None,
        as_json: JsonOption = False,
    ) -> None:
        bench = _make_bench(data, protocol, library, noise_mv, spread, touch)
        _run_study(study, bench, grasps, seed, out, jobs, as_json)

    return command


def _make_library_command(study: StudyDefinition) -> Callable[..., None]:
    def command(
        grasps: GraspsOption = study.default_count,
        noise_mv: NoiseOption = 2.0,
        spread: SpreadOption = 1.0,
        library: LibraryOption = "porcine",
        data: DataOption = None,
        touch: TouchOption = True,
        seed: SeedOption = 0,
        out: OutOption = DEFAULT_FOLDER,
        jobs: JobsOption = None,
        as_json: JsonOption = False,
    ) -> None:
        bench = _make_bench(data, "trapezoid_2hz", library, noise_mv, spread, touch)
        _run_study(study, bench, grasps, seed, out, jobs, as_json)

    return command


def _make_command(study: StudyDefinition) -> Callable[..., None]:
    """Make the command of a study, with the options that apply to it."""
    if not study.uses_conditions:
        return _make_seeds_command(study)
    if not study.uses_protocol:
        return _make_library_command(study)
    return _make_thickness_command(study) if study.uses_thickness else _make_protocol_command(study)


for entry in STUDIES.values():
    app.command(entry.name, help=entry.title)(_make_command(entry))


@app.command("spots", cls=LabelCommand)
def validate_on_new_spots(
    label: Annotated[list[str], typer.Option("--label", metavar=LABEL_METAVAR, help=LABEL_HELP)],
    recordings: Annotated[
        list[Path] | None, typer.Argument(metavar="FILE...", help="Recordings; a label may name each by its name.")
    ] = None,
    tool: Annotated[
        str | None,
        typer.Option(metavar="NAME|FILE", help="Tool file with the recordings' channels and calibration, as in learn."),
    ] = None,
    base: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="Library that injury thresholds, mass and jaw area come from.")
    ] = "porcine",
    data: DataOption = None,
    out: OutOption = DEFAULT_FOLDER,
    as_json: JsonOption = False,
) -> None:
    """Measure how often a learned library is right on spots that it was not learned from.

    Each recording is left out in turn.

    Example: graspwatch study spots liver1.lvm.gz liver2.lvm.gz bladder1.lvm.gz --label liver=liver1,liver2
    --label bladder=bladder1
    """
    from app.analysis.learning.spot_study import build_spot_study  # slow imports, made after the options are checked
    from app.analysis.learning.training_set import load_training_set
    from app.cli.learn import find_recording_tool
    from estimator.learning.library_fit import fit_recordings
    from estimator.learning.spot_validation import leave_recordings_out

    files = _collect_labeled_files(label, recordings or [])
    _check_output_folder(out)
    settings = load_settings()
    folder = locate_data_folder(data, settings)
    context, like = load_tool(tool, folder) if tool else find_recording_tool(files), load_library(base, folder)
    with ProgressBar("spots", 1.0) as progress:
        found = load_training_set(files, context, like, settings, 0, lambda share: progress(0.3 * share))
        today = date.today().isoformat()
        own, left_out = leave_recordings_out(
            found.recordings,
            partial(fit_recordings, tool=context, base=like, base_name=base, date=today),
            context,
            settings.identification,
            lambda share: progress(0.3 + 0.7 * share),
        )
    for remark in found.remarks:
        print_note(remark)
    if not own:
        print_note(
            "no tissue has two recordings, so nothing says how much spots differ. Record another spot of each tissue."
        )
    about = {"tool": context.name, "base": base, "recordings": str(len(found.recordings)), "date": today}
    print_study(build_spot_study(own, left_out, about), out, as_json)


def _collect_labeled_files(labels: list[str], recordings: list[Path]) -> dict[str, list[Path]]:
    """Return each tissue's recordings.

    Raises:
        ConfigurationError: a recording has no label, or two.
    """
    files: dict[str, list[Path]] = {}
    labeled: dict[Path, str] = {}
    for tissue, paths in parse_labels_of(labels, recordings):
        for path in paths:
            if labeled.setdefault(path, tissue) != tissue:
                raise ConfigurationError(f"{path} has two labels, {labeled[path]} and {tissue}. Keep the right one.")
            files.setdefault(tissue, []).append(path)
    if bare := [str(path) for path in recordings if path not in labeled]:
        raise ConfigurationError(f"No label says what {', '.join(bare)} held. Add --label TISSUE=FILE for each.")
    if len(files) < 2:
        raise ConfigurationError(
            f"All recordings are of {next(iter(files))}, so there is nothing to tell apart. Add recordings of another "
            "tissue."
        )
    return files


def _run_study(
    study: StudyDefinition, bench: "StudyConditions", grasps: int, seed: int, out: Path, jobs: int | None, as_json: bool
) -> None:
    """Run a study and print its result.

    Raises:
        ConfigurationError: the folder `out` cannot be written to, which is checked before the study.
        ServiceError: its disk is full.
    """
    _check_output_folder(out)
    with _ProgressDisplay(study.name) as progress:
        result = study.run(bench, grasps, seed, progress, jobs)
    print_study(result, out, as_json)


def _check_output_folder(out: Path) -> None:
    with explain_write_errors(out):
        check_writable(out)


def _make_bench(
    data: Path | None, protocol: str, library: str, noise_mv: float, spread: float, touch: bool, thickness: bool = True
) -> "StudyConditions":
    """Return the conditions that all grasps share.

    Raises:
        ConfigurationError: there is no such protocol or library.
    """
    own = locate_data_folder(data, load_settings())
    load_grasp_protocol(protocol, own)  # to refuse a wrong name before the study starts
    load_library(library, own)
    from estimator.studies.answer_course import StudyConditions  # a slow import

    protocol, library = (
        _name_own_by_path(protocol, FileKind.PROTOCOL, own),
        _name_own_by_path(library, FileKind.LIBRARY, own),
    )
    return StudyConditions(protocol, library, noise_mv, spread, touch, thickness)


def _name_own_by_path(name: str, kind: FileKind, data_folder: Path) -> str:
    """Return a shipped name as it is, and the path of an own file: a study's processes know no data folder."""
    return name if name in list_shipped_names(kind.folder) else str(find_file(name, kind, data_folder))


class _ProgressDisplay:
    """A study's progress: a bar with the time left, or without a terminal one line with it."""

    def __init__(self, title: str) -> None:
        columns = (TextColumn(title), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
        self._bar = Progress(*columns, console=error_console, transient=True, disable=not error_console.is_terminal)
        self._task = self._bar.add_task(title)
        self._title, self._estimate_printed = title, error_console.is_terminal
        # Time and number of the first cases done; compiling the filters took the time before.
        self._first_progress: tuple[float, int] | None = None

    def __enter__(self) -> "_ProgressDisplay":
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def __call__(self, done: int, of: int) -> None:
        self._bar.update(self._task, completed=done, total=of)
        now_s = time.monotonic()
        if done and self._first_progress is None:
            self._first_progress = now_s, done
        elif (
            self._first_progress
            and not self._estimate_printed
            and done >= ESTIMATE_AFTER_SHARE * of
            and now_s - self._first_progress[0] > ESTIMATE_AFTER_S
        ):
            self._estimate_printed = True
            left_s = (now_s - self._first_progress[0]) * (of - done) / (done - self._first_progress[1])
            error_console.print(f"{self._title}: {done} of {of} cases done, about {left_s:.0f} s left.", soft_wrap=True)
