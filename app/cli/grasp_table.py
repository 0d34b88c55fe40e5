"""The grasps of a run or recording, as a table or as JSON."""

import json
from typing import Any

from rich.table import Table

from app.cli.console import create_console, print_note
from config.schema import ReferenceGrasp

VERDICT_REMARKS = {"unknown": "fits no tissue of the library"}
HELD_BACK_REMARK = "held back"
HELD_BACK_TEXT = (
    "The limiter held the motor back in {}: its command was lower than the protocol asks for, so that the force stays "
    "under the limit."
)


def print_reports(documents: list[dict[str, Any]], as_json: bool) -> None:
    """Print one table a report, or one JSON document of them all."""
    if as_json:
        print(json.dumps(documents[0] if len(documents) == 1 else documents, indent=2, allow_nan=False))
        return
    console = create_console()
    for document in documents:
        if reference := document.get("reference"):
            taken = ReferenceGrasp.model_validate(reference, strict=False)
            console.print(f"Reference grasp of {taken.tool}: {taken}", highlight=False, soft_wrap=True)
            continue
        console.print(_build_table(document))
        for spot in document["spots"]:
            console.print(_describe_spot(spot), highlight=False)
        if held := [str(grasp["index"]) for grasp in document["grasps"] if grasp["held_back"]]:
            print_note(HELD_BACK_TEXT.format(f"grasp{'s'[: len(held) != 1]} {', '.join(held)}"))
        if advice := document.get("advice"):
            print_note(advice)


def _build_table(document: dict[str, Any]) -> Table:
    title = (
        f"{document['source']}: {document['samples']} samples in {document['duration_s']:.1f} s, "
        f"{document['lost_samples']} lost; library {document['library']}; {document['force_scale']}"
    )
    table = Table(title=title)
    for heading in ("Grasp", "Start", "Tissue", "Prob.", "Decided", "Peak"):
        table.add_column(heading, no_wrap=True)
    table.add_column("Remark")
    for grasp in document["grasps"]:
        probability, decided, peak = grasp["probability"], grasp["time_to_decision_s"], grasp["peak_force_n"]
        top, share = max(grasp["probabilities"].items(), key=lambda each: each[1])
        likeliest = f"likeliest: {top.replace('_', ' ')}, {100 * share:.0f} %" if grasp["label"] == "undecided" else ""
        said = grasp["why_invalid"] or VERDICT_REMARKS.get(grasp["label"]) or likeliest
        table.add_row(
            str(grasp["index"]),
            f"{grasp['start_s']:.3f} s",
            grasp["label"].replace("_", " "),
            "" if probability is None else f"{probability:.0%}",
            "" if decided is None else f"{decided * 1e3:.0f} ms",
            "" if peak is None else f"{peak:.2f} N",
            "; ".join(filter(None, (said, HELD_BACK_REMARK if grasp["held_back"] else ""))),
        )
    return table


def _describe_spot(spot: dict[str, Any]) -> str:
    """Return one line: `Spot 1: liver 97%, from 3 grasps, 4.2 N s`."""
    count = len(spot["grasps"])
    said = spot["label"].replace("_", " ")
    if spot["probability"] is not None:
        said += f" {spot['probability']:.0%}"
    elif count:
        top, share = max(spot["probabilities"].items(), key=lambda each: each[1])
        said += f", likeliest {top.replace('_', ' ')} {share:.0%}"
    dose = "" if spot["dose_n_s"] is None else f", {spot['dose_n_s']:.1f} N s"
    return f"Spot {spot['index']}: {said}, from {count} grasp{'' if count == 1 else 's'}{dose}"
