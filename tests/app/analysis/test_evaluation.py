"""Answers are judged by what was held: figures, confusion, what is left out, what deserves a second look."""

from typing import Any

import pytest
from reports import record

from app.analysis.evaluation import evaluate_answers
from app.messages.annotations import GraspRemark, GraspTruth
from app.recordings.grasp_rows import GraspContext, build_grasp_rows
from config.errors import ConfigurationError

ABOUT: dict[str, Any] = {}


def rows(*grasps: tuple[str | None, str, float], remark: GraspRemark | None = None, **facts: Any) -> list[dict]:
    """Rows of grasps: what was held, the answer, and its probability; the rest is `unknown`."""
    records, truths = [], {}
    for index, (held, label, probability) in enumerate(grasps, 1):
        shares = {"liver": 0.0, "bladder": 0.0, "unknown": 1.0 - probability} | {label: probability}
        shares.pop("undecided", None)
        records.append(record(index=index, label=label, probabilities=shares, **facts))
        truths[index] = GraspTruth(
            run_id="1", grasp=index, held=held, remark=remark, version=1, by="Ada", at="2026-11-30", why=None
        )
    return build_grasp_rows(GraspContext(recording="a.mcap", run_id="1"), records, (), truths, 0.0)


def figures(study: Any) -> dict[str, float]:
    return {figure.name: figure.value for figure in study.figures}


def table(study: Any, title: str) -> list[list]:
    return next(part.rows for part in study.parts if getattr(part, "title", "").startswith(title))


def test_right_and_wrong_names_are_counted_by_what_was_held() -> None:
    found = rows(
        ("liver", "liver", 0.99), ("bladder", "liver", 0.97), ("spleen", "unknown", 0.9), ("liver", "bladder", 0.7)
    )
    study = evaluate_answers({"porcine": found}, ABOUT)
    told = figures(study)
    assert told["grasps"] == 4
    assert (told["named right"], told["named wrong"], told["unknown"]) == (25.0, 50.0, 25.0)
    assert told["confident and wrong"] == 25.0
    assert told["right by the likeliest"] == 50.0  # a spleen is rightly none of the library
    assert table(study, "By truth") == [
        ["bladder", 1, 0, 0, 1, pytest.approx(0.0)],
        ["liver", 2, 1, 1, 1, pytest.approx(0.495)],
        ["spleen", 1, 1, 0, 0, pytest.approx(0.9)],
    ]
    assert [row[:3] for row in table(study, "To look at again")] == [
        ["a.mcap", 4, "liver"],
        ["a.mcap", 2, "bladder"],
        ["a.mcap", 3, "spleen"],
    ]


def test_grasps_that_nobody_can_judge_are_left_out_and_told() -> None:
    known = rows(("liver", "liver", 0.99))
    slipped = rows(("liver", "liver", 0.99), remark=GraspRemark.SLIPPED)
    invalid = rows(("liver", "undecided", 0.0), valid=False, why_invalid="encoder slips or walks")
    study = evaluate_answers({"porcine": known + slipped + invalid + rows((None, "liver", 0.9))}, ABOUT)
    assert figures(study)["grasps"] == 1
    assert sorted(table(study, "Left out")) == [
        [1, "invalid: encoder slips or walks"],
        [1, "of which a person says: slipped"],
        [1, "without a truth"],
    ]
    with pytest.raises(ConfigurationError, match=r"No grasp can be judged \(1 without a truth\)"):
        evaluate_answers({"porcine": rows((None, "liver", 0.9))}, ABOUT)


def test_figures_are_given_by_session_where_there_are_several() -> None:
    found = rows(("liver", "liver", 0.99), ("liver", "bladder", 0.8))
    titles = [getattr(part, "title", "") for part in evaluate_answers({"porcine": found}, ABOUT).parts]
    assert "By session: porcine" not in titles
    for row, session in zip(found, ("S1", "S2"), strict=True):
        row["session"] = session
    by_session = table(evaluate_answers({"porcine": found}, ABOUT), "By session")
    assert [row[:5] for row in by_session] == [["S1", 1, 1, 1, 0], ["S2", 1, 0, 0, 1]]


def test_two_libraries_stand_side_by_side() -> None:
    better, worse = rows(("liver", "liver", 0.99)), rows(("liver", "bladder", 0.6))
    study = evaluate_answers({"learned": better, "porcine": worse}, ABOUT)
    told = figures(study)
    assert (told["learned: named right"], told["porcine: named right"]) == (100.0, 0.0)
    assert told["porcine: log loss"] > told["learned: log loss"]
    titles = [part.title for part in study.parts if hasattr(part, "columns")]
    assert {"To look at again: learned", "To look at again: porcine"} <= {*titles}
    assert "To look at again: porcine" in study.render_page()
