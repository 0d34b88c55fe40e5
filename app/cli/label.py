"""`graspwatch label`: what was held in the grasps of a recording, said afterwards."""

import contextlib
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from app.cli.console import print_note
from app.cli.options import ConfigOption, DataOption, find_data_folder
from app.host.computer_user import computer_user_name
from app.messages.annotations import MAX_PLACE_LETTERS, GraspRemark, GraspTruth
from app.messages.journal import JournalEntry, JournalKind
from config.errors import ConfigurationError, JournalError, RecordingError
from config.load import load_settings
from config.tissue_names import normalize_tissue_name


def label(
    run: Annotated[str, typer.Argument(metavar="RUN", help="Run or recording of the data folder.")],
    held: Annotated[
        str | None, typer.Option(metavar="TISSUE", help="Tissue that was held; without: not known.")
    ] = None,
    grasp: Annotated[
        list[int] | None, typer.Option(min=1, metavar="N", help="Only this grasp; repeat it for more. Default: all.")
    ] = None,
    remark: Annotated[GraspRemark | None, typer.Option(help="What was peculiar about the grasps.")] = None,
    place: Annotated[
        str | None, typer.Option(metavar="TEXT", help="Place on the organ; without: as stated before.")
    ] = None,
    why: Annotated[str | None, typer.Option(metavar="TEXT", help="Reason, where earlier statements change.")] = None,
    config: ConfigOption = None,
    data: DataOption = None,
) -> None:
    """State or correct what was held in the grasps of a recording. The journal keeps every statement.

    A statement replaces tissue and remark of the earlier one; its place stays.

    Example: graspwatch label 20261201-101500-7f3a-001 --held liver --grasp 1 --grasp 2
    """
    settings = load_settings(config)
    folder = find_data_folder(data, settings)
    if held is None and remark is None and place is None and why is None:
        raise ConfigurationError(
            "Say what was held with --held, --remark or --place; to take a statement back, say --why."
        )
    if place is not None and not 0 < len(place.strip()) <= MAX_PLACE_LETTERS:
        raise ConfigurationError(f"--place: write 1 to {MAX_PLACE_LETTERS} letters.")
    tissue = normalize_tissue_name(held, "--held") if held else None
    path = folder / "recordings" / f"{run.removesuffix('.mcap')}.mcap"
    if Path(run).name != run or not path.is_file():
        raise RecordingError(f"There is no recording {run!r} in {path.parent}. `graspwatch import` takes others in.")

    from app.audit.journal import Journal
    from app.index.database import explain_database_errors, index_url_from_settings
    from app.index.opening import ingest_if_missing, ingest_journal_tail
    from app.index.store import Store
    from app.recordings.grasp_rows import read_recorded_grasps
    from app.recordings.index_reader import RECORDING_READERS  # slow imports, made after the options are checked

    recorded = read_recorded_grasps(path)
    run_id = recorded.context.run_id or path.stem
    known = [each.index for each in recorded.grasps]
    chosen = sorted(set(grasp)) if grasp else known
    if missing := sorted(set(chosen) - set(known)):
        raise RecordingError(f"{path.name} has no grasp {missing[0]}: it has {len(known)}.")
    if not chosen:
        raise RecordingError(f"{path.name} has no grasp.")
    lines: list[JournalEntry] = []
    with contextlib.closing(Store(index_url_from_settings(settings, folder))) as store:
        ingest_journal_tail(store, folder / "journal.jsonl")
        ingest_if_missing(store, path, RECORDING_READERS)
        before = {each.grasp: each for each in store.list_run_truths(run_id)}
        changed = [each for each in chosen if each in before]
        if changed and not why:
            raise ConfigurationError(f"Grasp {changed[0]} has a statement already. Say with --why why it is changed.")
        journal = Journal(folder, _refuse, lines.append)
        by, at = computer_user_name(), datetime.now(UTC).isoformat(timespec="milliseconds")
        try:
            for index in chosen:
                truth = GraspTruth(
                    run_id=run_id,
                    grasp=index,
                    held=tissue,
                    remark=remark,
                    place=place.strip() if place else before[index].place if index in before else None,
                    version=before[index].version + 1 if index in before else 1,
                    by=by,
                    at=at,
                    why=why if index in before else None,
                )
                journal.write(JournalKind.TRUTH, truth.describe(), by=by, truth=truth)
        finally:  # what is in the journal has to be in the index, too
            with explain_database_errors(store.url):
                store.ingest_all((line, None) for line in lines)
    print(f"{path.name}: {len(chosen)} of {len(known)} grasps labeled")
    if tissue is None and remark is None and place is None:
        print_note("Nothing is stated of them now: --held names what was held.")


def _refuse(fault: str | None) -> None:
    if fault:
        raise JournalError(fault)
