"""The page that studies and reports share."""

import numpy as np
import pytest
from markupsafe import Markup

from estimator.studies.html_page import Table, format_value, render_template, to_json_value


def render(parts: list[Table]) -> str:
    return render_template(
        "study.html.jinja", kind="Graspwatch test", title="A < B", settings={}, explanation="", parts=parts
    )


@pytest.mark.parametrize(
    ("value", "told"),
    [
        (None, "–"),
        (float("nan"), "–"),
        (float("inf"), "–"),
        (0.012345, "0.0123"),
        (1926.6, "1927"),
        (3, "3"),
        ("word", "word"),
        (-1500.2, "-1500"),
        (2.5e7, "2.5e+07"),
    ],
)
def test_a_value_is_told_with_three_digits_or_those_before_the_point(value, told):
    assert format_value(value) == told


def test_words_are_escaped_and_stand_to_the_left_below_their_heading():
    rows = [["<i>", 1.0, None], ["b", 2.0, Markup("<b>bold</b>")]]
    told = render([Table("<A & B>", ["what <", "n", "how"], rows)])
    assert "<h2>&lt;A &amp; B&gt;</h2>" in told
    assert '<th scope="row">&lt;i&gt;</th><td>1</td><td>–</td>' in told
    assert '<td class="words"><b>bold</b></td>' in told
    assert '<th scope="col" class="words">how</th>' in told
    assert '<th scope="col">n</th>' in told


def test_a_document_allows_nothing_from_elsewhere_and_says_what_made_it():
    page = render([])
    assert 'http-equiv="Content-Security-Policy" content="default-src &#39;none&#39;; ' in page
    assert '<meta name="generator" content="Graspwatch test">' in page[:300]
    assert "<title>A &lt; B</title>" in page


def test_plain_is_what_json_can_tell():
    assert to_json_value({1: np.float64(2.0), "a": (np.int64(3), float("nan"), [np.bool_(True)])}) == {
        "1": 2.0,
        "a": [3, None, [True]],
    }
