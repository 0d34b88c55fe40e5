"""`graspwatch report`: a page and a JSON about recordings and their tissues."""

import difflib
import itertools
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from acquisition.recordings.file_names import RECORDING_SUFFIXES, remove_recording_suffix, to_printable
from app.cli.console import create_console, print_note
from app.cli.label_option import LABEL_HELP, LABEL_METAVAR, parse_labels_of
from app.cli.options import DEFAULT_RECORDING_TOOL, ProgressBar, locate_data_folder, write_output
from config.errors import ConfigurationError
from config.load import load_library, load_settings, load_tool
from config.schema import TissueLibrary

if TYPE_CHECKING:
    from app.analysis.report.report import Report

# An earlier report, which may be overwritten, has its marker in its first bytes.
PAGE_MARKER, DATA_MARKER = ('<meta name="generator" content="Graspwatch report">', '"report": "Report: ')
MARKER_SEARCH_BYTES = 1000


def report(
    recordings: Annotated[
        list[str] | None,
        typer.Argument(metavar="RUN|FILE...", help="Recordings (.mcap, .lvm, .lvm.gz), or runs of the data folder."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The page; default: a new report.html or report-NAME.html here.")
    ] = None,
    label: Annotated[
        list[str] | None,
        typer.Option(
            metavar=LABEL_METAVAR, help=f"{LABEL_HELP} Without a label, a recording's own word or the verdicts count."
        ),
    ] = None,
    library: Annotated[str | None, typer.Option(metavar="NAME|FILE", help="Tissue library: a name or a file.")] = None,
    tool: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="Tool file with channels and calibration of LabVIEW's recordings.")
    ] = DEFAULT_RECORDING_TOOL,
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Settings instead of config/graspwatch.toml.")
    ] = None,
    data: Annotated[Path | None, typer.Option(metavar="FOLDER", help="Data folder; default: as configured.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the JSON instead of a table.")] = False,
) -> None:
    """Write a report: courses, verdicts, warnings, stress over strain, and what the grasps say of the tissues.

    The page needs nothing but a browser, and can be printed; beside it lies a JSON with every figure.

    Example: graspwatch report liver.lvm.gz bladder.lvm.gz --label liver=liver.lvm.gz --out report.html
    """
    settings = load_settings(config)
    own = locate_data_folder(data, settings)
    profiles, context = load_library(library or settings.library, own), load_tool(tool, own)
    folder = own / "recordings"
    files = [_find_recording(name, folder) for name in recordings or []]
    if len(set(files)) < len(files):
        twice = next(path for path in files if files.count(path) > 1)
        raise ConfigurationError(f"{twice} is named twice. Name each recording once.")
    labels = _assign_labels(label or [], files, profiles)
    if not files:
        raise ConfigurationError("Name at least one recording, before the options or in a --label.")
    page_path = out or _choose_page_path(files)
    data_path = page_path.with_suffix(".json")
    _check_output_paths(page_path, data_path)

    from app.analysis.learning.grasp_reader import find_learned_files
    from app.analysis.report.page import render_report_page  # a slow import, made after the options are checked
    from app.analysis.report.report import analyze_recordings, read_common_configuration

    if library is None and config is None:
        profiles, settings = read_common_configuration(files) or (profiles, settings)

    if known := find_learned_files(profiles, files):
        print_note(
            f"the library was learned from {', '.join(known)}, so its answers for them are better than for other "
            "recordings. `graspwatch study spots` judges it on recordings that it was not learned from."
        )
    with ProgressBar(page_path.name, 1.0) as progress:
        made = analyze_recordings(files, context, profiles, settings, labels, progress)
        text, document = (
            render_report_page(made, progress),
            json.dumps(made.document(), indent=2, allow_nan=False) + "\n",
        )
    write_output(page_path, text)
    write_output(data_path, document)
    if as_json:
        print(document, end="")
        return
    _print_summary(made, page_path, data_path)


def _find_recording(name: str, folder: Path) -> Path:
    """Find a file by its path, or a recording of the data folder by its name, with or without its suffix.

    Raises:
        ConfigurationError: there is no such file or recording.
    """
    places = [Path(name), *(folder / f"{name}{ending}" for ending in ("", *RECORDING_SUFFIXES))]
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        raise ConfigurationError(f"{name}: there is no such file, and no such recording in {folder}. Check the name.")
    return path


def _assign_labels(labels: list[str], files: list[Path], library: TissueLibrary) -> dict[Path, str]:
    """Return the tissue that was held, by file; add files that only a label names to `files`.

    Raises:
        ConfigurationError: a label is malformed, or does not name exactly one unlabeled recording of the report.
    """
    held: dict[Path, str] = {}
    for tissue, named in parse_labels_of(labels, files):
        _check_spelling(tissue, library)
        for path in named:
            if path in held:
                raise ConfigurationError(f"--label {tissue}: {path} has a label already, {held[path]}.")
            held[path] = tissue
    files += [path for path in held if path not in files]
    return held


def _check_spelling(tissue: str, library: TissueLibrary) -> None:
    """Accept a tissue that is not in the library, but not a misspelling of one that is."""
    if tissue in library.tissues:
        return
    if close := difflib.get_close_matches(tissue, library.tissues, n=1, cutoff=0.8):
        raise ConfigurationError(f"--label: there is no tissue {tissue!r}. Did you mean {close[0]!r}?")


def _choose_page_path(files: list[Path]) -> Path:
    """Return a name in this folder that no page and no JSON has."""
    stem = "report" if len(files) > 1 else f"report-{to_printable(remove_recording_suffix(files[0].name))}"
    names = (stem if n == 1 else f"{stem}-{n}" for n in itertools.count(1))
    free = (name for name in names if not any(Path(name + ending).exists() for ending in (".html", ".json")))
    return Path(next(free) + ".html")


def _check_output_paths(page: Path, data: Path) -> None:
    """Check that both files can be written, and that they overwrite nothing but an earlier report.

    Raises:
        ConfigurationError: a file cannot be written, or would overwrite something else.
    """
    if page.suffix not in (".html", ".htm"):
        raise ConfigurationError(f"--out {page}: the page's name must end in .html.")
    if not page.parent.is_dir():
        raise ConfigurationError(f"--out {page}: there is no folder {page.parent}. Make it, or name another file.")
    if not os.access(page.parent, os.W_OK):
        raise ConfigurationError(f"--out {page}: {page.parent} cannot be written to. Name a file in another folder.")
    for path, own in ((page, PAGE_MARKER), (data, DATA_MARKER)):
        try:
            with path.open("rb") as file:
                begin = file.read(MARKER_SEARCH_BYTES).decode(errors="replace")
        except FileNotFoundError:
            continue
        except OSError as error:
            raise ConfigurationError(
                f"{path}: cannot be replaced ({error.strerror}). Name another with --out."
            ) from None
        if own not in begin:
            raise ConfigurationError(f"{path} is there already and is no report. Name another file with --out.")


def _print_summary(report_result: "Report", page: Path, data: Path) -> None:
    from estimator.studies.html_page import format_value

    found, looks, console = report_result.statistics, report_result.tissue_styles, create_console()
    table = Table("Held", "Grasps", "Converged", "Mean time, s", "α, N", "β, 1/m", "d, kg/s", title=report_result.title)
    for name, row in found.convergence.items():
        time = row.convergence_s
        means = [one.geometric_mean for one in found.parameters[name].values()]
        table.add_row(looks[name].title, str(row.grasps), str(time.count), *map(format_value, (time.mean, *means)))
    if found.groups:
        console.print(table)
    for pair, telling in found.find_distinguishing_parameters().items():
        words = f"told apart by {', '.join(telling)}" if telling else "not told apart by any parameter"
        console.print(f"{' and '.join(looks[name].title for name in pair)}: {words}.")
    left_out = f", {len(found.excluded)} of them left out of the statistics" if found.excluded else ""
    console.print(f"{len(report_result.grasps)} grasps{left_out}.")
    console.print(f"Report: {page}\nFigures: {data}", soft_wrap=True)
