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

GraspsOption = Annotated[int, typer.Option(min=1, max=100_000, help="Grasps of each tissue (and of each condition).")]
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


@app.command()
def paper(
    seeds: Annotated[int, typer.Option(min=1, max=1000, help="Noises and wrong guesses of each tissue.")] = 10,
    seed: SeedOption = 0, out: OutOption = Path("studies"), jobs: JobsOption = None, as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Tables III, IV and V and Figures 4 and 5 of the paper, beside its own scheme and ours."""
    from estimator.studies.paper import paper as study

    _show(_run("paper", study, jobs, seeds, seed), out, as_json)


@app.command()
def identify(
    grasps: GraspsOption = 250, noise_mv: NoiseOption = 2.0, spread: SpreadOption = 1.0,
    protocol: ProtocolOption = "trapezoid_2hz", library: LibraryOption = "porcine", touch: TouchOption = True,
    thickness: ThicknessOption = True, seed: SeedOption = 0, out: OutOption = Path("studies"), jobs: JobsOption = None,
    as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Share right against time beside the Bayes limit, confusion, calibration, decisions, errors of parameters."""
    from estimator.studies.identify import identify as study

    bench = _bench(protocol, library, noise_mv, spread, touch, thickness)
    _show(_run("identify", study, jobs, bench, grasps, seed), out, as_json)


@app.command()
def unknown(
    grasps: GraspsOption = 100, noise_mv: NoiseOption = 2.0, spread: SpreadOption = 1.0,
    protocol: ProtocolOption = "trapezoid_2hz", library: LibraryOption = "porcine", touch: TouchOption = True,
    thickness: ThicknessOption = True, seed: SeedOption = 0, out: OutOption = Path("studies"), jobs: JobsOption = None,
    as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Tissues and things outside the library: called unknown? And the library's own: wrongly so?"""
    from estimator.studies.unknown import unknown as study

    bench = _bench(protocol, library, noise_mv, spread, touch, thickness)
    _show(_run("unknown", study, jobs, bench, grasps, seed), out, as_json)


@app.command()
def initial(
    grasps: GraspsOption = 2, noise_mv: NoiseOption = 2.0, spread: SpreadOption = 1.0,
    protocol: ProtocolOption = "trapezoid_2hz", library: LibraryOption = "porcine", touch: TouchOption = True,
    seed: SeedOption = 0, out: OutOption = Path("studies"), jobs: JobsOption = None, as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Guesses of alpha and beta off by 0.1 to 10 times: share converged within 0.3 s, beside the paper's filter."""
    from estimator.studies.initial import initial as study

    bench = _bench(protocol, library, noise_mv, spread, touch, thickness=True)
    _show(_run("initial", study, jobs, bench, grasps, seed), out, as_json)


@app.command()
def mismatch(
    grasps: GraspsOption = 100, noise_mv: NoiseOption = 2.0, spread: SpreadOption = 1.0,
    protocol: ProtocolOption = "trapezoid_2hz", library: LibraryOption = "porcine", touch: TouchOption = True,
    thickness: ThicknessOption = True, seed: SeedOption = 0, out: OutOption = Path("studies"), jobs: JobsOption = None,
    as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Truth that differs from the model: damping, relaxation, late touch, scales, motion, mass, friction."""
    from estimator.studies.mismatch import mismatch as study

    bench = _bench(protocol, library, noise_mv, spread, touch, thickness)
    _show(_run("mismatch", study, jobs, bench, grasps, seed), out, as_json)


@app.command()
def estimators(
    grasps: GraspsOption = 60, noise_mv: NoiseOption = 2.0, spread: SpreadOption = 1.0,
    protocol: ProtocolOption = "trapezoid_2hz", library: LibraryOption = "porcine", touch: TouchOption = True,
    seed: SeedOption = 0, out: OutOption = Path("studies"), jobs: JobsOption = None, as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Ours, the paper's filter, an unscented and a particle filter on the same grasps."""
    from estimator.studies.estimators import estimators as study

    bench = _bench(protocol, library, noise_mv, spread, touch, thickness=False)
    _show(_run("estimators", study, jobs, bench, grasps, seed), out, as_json)


def _run(title: str, study: Callable[..., "Study"], jobs: int | None, *asked: object) -> "Study":
    """Carry out a study of what was asked, and show how far it is."""
    with _Progress(title) as progress:
        return study(*asked, progress, jobs)


def _bench(protocol: str, library: str, noise_mv: float, spread: float, touch: bool, thickness: bool) -> "Bench":
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
