"""`graspwatch learn`: a tissue library from labeled recordings, and a report of how far it can be trusted."""

import json
from datetime import date
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from app.cli.console import create_console, print_note
from app.cli.label_option import LABEL_HELP, LABEL_METAVAR, parse_labels
from app.cli.options import DEFAULT_RECORDING_TOOL, DataOption, ProgressBar, locate_data_folder, write_output
from config.errors import ConfigurationError
from config.load import load_library, load_settings, load_tool
from config.schema import TissueLibrary, Tool
from config.tissue_names import check_tissue_names

if TYPE_CHECKING:
    from app.analysis.learning.training_set import TrainingSet
    from estimator.studies.study_report import StudyResult

READING_SHARE = 0.3  # of the time that learning takes


def learn(
    label: Annotated[list[str], typer.Option("--label", metavar=LABEL_METAVAR, help=LABEL_HELP)],
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE.toml", help="The library to write; a report goes beside it.")
    ],
    tool: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE",
            help="Tool file with the recordings' channels and calibration; default: the one in the first .mcap file, "
            f"for LabVIEW's {DEFAULT_RECORDING_TOOL}.",
        ),
    ] = None,
    base: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="Library that injury thresholds, mass and jaw area come from.")
    ] = "porcine",
    least: Annotated[
        int, typer.Option(min=2, max=10_000, help="Grasps that each tissue needs, without first ones.")
    ] = 5,
    reference: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="Recording with empty jaws, for the recordings of its day: the zero of stall and stops; repeatable.",
        ),
    ] = None,
    config: Annotated[
        Path | None, typer.Option("--config", metavar="FILE", help="Settings instead of config/graspwatch.toml.")
    ] = None,
    data_folder: DataOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON instead of a table.")] = False,
) -> None:
    """Learn a tissue library from labelled recordings, and say how far it can be trusted.

    First grasps of a recording, slipping encoders and other unsound grasps are left out; outlying ones count less.

    Example: graspwatch learn --label liver=liver4Hz1.lvm.gz --label bladder=bladder4Hz1.lvm.gz --out learned.toml
    """
    from app.analysis.learning.library_file import check_writable, library_to_toml

    files, settings = parse_labels(label), load_settings(config)
    check_tissue_names(files, "--label")
    own = locate_data_folder(data_folder, settings)
    context, like = load_tool(tool, own) if tool else find_recording_tool(files), load_library(base, own)
    page, data = (out.with_name(f"{out.stem}-report.{kind}") for kind in ("html", "json"))
    check_writable(out)
    for path in (out, page, data):
        if path.exists():
            raise ConfigurationError(f"{path}: exists already, and is kept. Name another file with --out.")

    from app.analysis.learning.learning_report import build_report
    from app.analysis.learning.training_set import (
        load_training_set,
    )  # a slow import, made after the options are checked
    from estimator.learning.cross_validation import cross_validate
    from estimator.learning.library_fit import fit_library, fit_recordings

    today = date.today().isoformat()
    with ProgressBar("learning", 1.0) as progress:
        found = load_training_set(
            files, context, like, settings, least, lambda share: progress(READING_SHARE * share), reference or ()
        )
        library = fit_library(
            found.curves, context, like, base, found.peak_v, name=_make_library_name(out.stem), date=today
        )
        answers = cross_validate(
            found.recordings,
            partial(fit_recordings, tool=context, base=like, base_name=base, date=today),
            context,
            settings.identification,
            lambda share: progress(READING_SHARE + (1 - READING_SHARE) * share),
        )
    study = build_report(library.name, library, answers, {"tool": context.name, "base": base, "date": today})
    write_output(page, study.render_page())
    write_output(data, json.dumps(study.to_document(), indent=2, allow_nan=False) + "\n")
    write_output(out, library_to_toml(library))
    _print_result(study, library, like, found, out, page, data, as_json)


def find_recording_tool(files: dict[str, list[Path]]) -> Tool:
    """Return the tool of the first MCAP file, or without one the default tool of LabVIEW logs."""
    from acquisition.recordings.mcap_reader import McapFile
    from acquisition.recordings.recording import is_mcap, read_recorded_tool

    known = (path for paths in files.values() for path in paths if is_mcap(path))
    first = next(known, None)
    return read_recorded_tool(McapFile(first)) if first else load_tool(DEFAULT_RECORDING_TOOL)


def _make_library_name(text: str) -> str:
    letters = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in text.lower()).strip("_")
    return letters or "learned"


def _print_result(
    study: "StudyResult",
    library: TissueLibrary,
    base: TissueLibrary,
    training_set: "TrainingSet",
    out: Path,
    page: Path,
    data: Path,
    as_json: bool,
) -> None:
    remarks = [*training_set.remarks, *_missing_threshold_warnings(library, base), *_list_missing_spots(library)]
    for remark in remarks:
        print_note(remark)
    if as_json:
        print(json.dumps(_build_document(study, library, out), indent=2, allow_nan=False))
        return
    console = create_console()
    tissues = Table("Tissue", "Recordings", "Grasps", "alpha", "beta", "d", "Threshold", title=library.title)
    for name, profile in library.tissues.items():
        learned = profile.learned
        if learned:
            tissues.add_row(
                name,
                str(len(learned.recordings)),
                str(learned.grasps),
                f"{profile.alpha_n:.3g} N",
                f"{profile.beta_per_m:.3g} /m",
                f"{profile.damping_kg_per_s:.3g} kg/s",
                f"{profile.threshold_pa / 1e3:g} kPa",
            )
    console.print(tissues)
    figures = Table("Figure", "Measured", title="On grasps it was not learned from")
    for figure in study.figures:
        figures.add_row(figure.name, "–" if figure.value is None else f"{figure.value:.3g} {figure.unit}".rstrip())
    console.print(figures)
    console.print(f"Library: {out}\nReport: {page}\nFigures: {data}", soft_wrap=True)


def _missing_threshold_warnings(library: TissueLibrary, base: TissueLibrary) -> list[str]:
    from estimator.learning.library_fit import find_base_tissue

    strange = [name for name in library.tissues if find_base_tissue(name, base) is None]
    if not strange:
        return []
    lowest = min(each.threshold_pa for each in base.tissues.values()) / 1e3
    return [
        f"the library {base.name!r} does not know {', '.join(strange)}: its lowest injury threshold, {lowest:g} kPa, "
        "is taken. If a higher one is known, put it into the file."
    ]


def _list_missing_spots(library: TissueLibrary) -> list[str]:
    """Return what the library cannot know, because too few tissues or spots were recorded."""
    remarks = []
    if len(library.tissues) == 1:
        remarks.append(
            f"every grasp can only be {', '.join(library.tissues)} or unknown. Add recordings of another tissue."
        )
    if library.learned and not library.learned.spot_pairs:
        remarks.append(
            "no tissue was recorded on two spots at one ramp, so the spread between spots is the stated one. The "
            "figures of earlier and later grasps are from the spots that were learned, and too good for other spots. "
            "Record each tissue on another spot; `graspwatch study spots` then judges the library on spots that it "
            "was not learned from."
        )
    return remarks


def _build_document(study: "StudyResult", library: TissueLibrary, out: Path) -> dict[str, Any]:
    return {
        "library": str(out),
        "tissues": library.model_dump(mode="json", exclude_none=True)["tissues"],
        **study.to_document(),
    }
