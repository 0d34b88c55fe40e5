"""`graspwatch study`: measures how right, how early and how honest the estimator is; writes a page and a JSON."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from config.load import load_library, load_protocol
from estimator.studies.catalogue import MOST_GRASPS, STUDIES, StudyEntry

if TYPE_CHECKING:
    from estimator.studies.course import Bench
    from estimator.studies.report import Study

app = typer.Typer(
    help="Measure how right, how early and how honest the estimator is. Each study writes a self-contained HTML page "
    "and a JSON of every figure, and uses all cores.",
    no_args_is_help=True,
)
errors = Console(stderr=True, highlight=False)
SAYS_AFTER, SAYS_AFTER_S = 0.05, 1.0  # of the cases, and seconds, when there is no terminal for a bar
FOLDER = Path("studies")

GraspsOption = Annotated[
    int, typer.Option(min=1, max=MOST_GRASPS, help="Grasps of each tissue (and of each condition).")
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


def _with_seeds(study: StudyEntry) -> Callable[..., None]:
    def command(
        seeds: Annotated[
            int, typer.Option(min=1, max=study.most, help="Noises and wrong guesses of each tissue.")
        ] = study.usual,
        seed: SeedOption = 0,
        out: OutOption = FOLDER,
        jobs: JobsOption = None,
        as_json: JsonOption = False,
    ) -> None:
        from estimator.studies.course import Bench  # takes a second

        _show(_run(study, Bench(), seeds, seed, jobs), out, as_json)

    return command


def _with_thickness(study: StudyEntry) -> Callable[..., None]:
    def command(
        grasps: GraspsOption = study.usual,
        noise_mv: NoiseOption = 2.0,
        spread: SpreadOption = 1.0,
        protocol: ProtocolOption = "trapezoid_2hz",
        library: LibraryOption = "porcine",
        touch: TouchOption = True,
        thickness: ThicknessOption = True,
        seed: SeedOption = 0,
        out: OutOption = FOLDER,
        jobs: JobsOption = None,
        as_json: JsonOption = False,
    ) -> None:
        bench = _bench(protocol, library, noise_mv, spread, touch, thickness)
        _show(_run(study, bench, grasps, seed, jobs), out, as_json)

    return command


def _without_thickness(study: StudyEntry) -> Callable[..., None]:
    def command(
        grasps: GraspsOption = study.usual,
        noise_mv: NoiseOption = 2.0,
        spread: SpreadOption = 1.0,
        protocol: ProtocolOption = "trapezoid_2hz",
        library: LibraryOption = "porcine",
        touch: TouchOption = True,
        seed: SeedOption = 0,
        out: OutOption = FOLDER,
        jobs: JobsOption = None,
        as_json: JsonOption = False,
    ) -> None:
        _show(_run(study, _bench(protocol, library, noise_mv, spread, touch), grasps, seed, jobs), out, as_json)

    return command


def _without_protocol(study: StudyEntry) -> Callable[..., None]:
    def command(
        grasps: GraspsOption = study.usual,
        noise_mv: NoiseOption = 2.0,
        spread: SpreadOption = 1.0,
        library: LibraryOption = "porcine",
        touch: TouchOption = True,
        seed: SeedOption = 0,
        out: OutOption = FOLDER,
        jobs: JobsOption = None,
        as_json: JsonOption = False,
    ) -> None:
        _show(_run(study, _bench("trapezoid_2hz", library, noise_mv, spread, touch), grasps, seed, jobs), out, as_json)

    return command


def _command(study: StudyEntry) -> Callable[..., None]:
    """The study as a command, with the options that mean something to it."""
    if not study.on_bench:
        return _with_seeds(study)
    if not study.plays_protocol:
        return _without_protocol(study)
    return _with_thickness(study) if study.weighs_thickness else _without_thickness(study)


for entry in STUDIES.values():
    app.command(entry.name, help=entry.title)(_command(entry))


def _run(study: StudyEntry, bench: "Bench", grasps: int, seed: int, jobs: int | None) -> "Study":
    """Carry out a study, and show how far it is."""
    with _Progress(study.name) as progress:
        return study.carry_out(bench, grasps, seed, progress, jobs)


def _bench(protocol: str, library: str, noise_mv: float, spread: float, touch: bool, thickness: bool = True) -> "Bench":
    """What the grasps have in common; a wrong name is told before anything starts.

    Raises:
        ConfigurationError: there is no such protocol or library.
    """
    load_protocol(protocol)
    load_library(library)
    from estimator.studies.course import Bench  # takes a second

    return Bench(protocol, library, noise_mv, spread, touch, thickness)


class _Progress:
    """How far a study is: a bar with the time left; where there is no terminal, one line that tells it."""

    def __init__(self, title: str) -> None:
        columns = (TextColumn(title), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
        self._bar = Progress(*columns, console=errors, transient=True, disable=not errors.is_terminal)
        self._task = self._bar.add_task(title)
        self._title, self._said = title, errors.is_terminal
        self._first: tuple[float, int] | None = None  # when the first cases were done, and how many: after compiling

    def __enter__(self) -> "_Progress":
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def __call__(self, done: int, of: int) -> None:
        self._bar.update(self._task, completed=done, total=of)
        now_s = time.monotonic()
        if done and self._first is None:
            self._first = now_s, done
        elif self._first and not self._said and done >= SAYS_AFTER * of and now_s - self._first[0] > SAYS_AFTER_S:
            self._said = True
            left_s = (now_s - self._first[0]) * (of - done) / (done - self._first[1])
            errors.print(f"{self._title}: {done} of {of} cases done, about {left_s:.0f} s left.", soft_wrap=True)


def _show(study: "Study", out: Path, as_json: bool) -> None:
    page, data = study.write(out)
    if as_json:
        print(json.dumps(study.document(), indent=2, allow_nan=False))
        return
    table = Table("Figure", "Measured", "To reach", "", title=study.title)
    words = {True: "reached", False: "[bold red]not reached[/]", None: ""}
    for figure in study.figures:
        value = "–" if figure.value is None else f"{figure.value:.3g} {figure.unit}".rstrip()
        table.add_row(figure.name, value, figure.floor, words[figure.reached])
    console = Console()
    console.print(table)
    console.print(f"Report: {page}\nFigures: {data}", soft_wrap=True, highlight=False)
