"""What `--label` understands."""

from itertools import pairwise
from pathlib import Path

import pytest

from app.cli.label_option import expand_label_arguments, parse_labels
from config.errors import ConfigurationError


@pytest.mark.parametrize(
    "typed",
    [
        ["--label", "liver=a", "--label", "liver=b", "--label", "bladder=c"],
        ["--label", "liver=a", "b", "--label", "bladder=c"],
        ["--label=liver=a", "b", "--label=bladder=c"],
        ["--label", "liver=a,b", "--label", "bladder=c"],
        ["--label", "liver=a, b", "--label", "bladder=c", "--out", "x.toml"],
        ["--out", "x.toml", "--label", "Liver=a", "b", "--json", "--label", "bladder=c"],
    ],
)
def test_files_follow_their_label_in_every_natural_way(typed):
    spread = expand_label_arguments(typed)
    labels = [arg.removeprefix("--label=") for arg in spread if arg.startswith("--label=")]
    labels += [after for before, after in pairwise(spread) if before == "--label"]
    found = parse_labels(sorted(labels))
    assert found == {"bladder": [Path("c")], "liver": [Path("a"), Path("b")]}


def test_a_pattern_finds_its_files(tmp_path):
    for name in ("liver2.lvm", "liver1.lvm", "other.lvm"):
        (tmp_path / name).touch()
    assert parse_labels([f"liver={tmp_path}/liver*.lvm"])["liver"] == [tmp_path / "liver1.lvm", tmp_path / "liver2.lvm"]
    with pytest.raises(ConfigurationError, match="no file fits"):
        parse_labels([f"liver={tmp_path}/ureter*.lvm"])


def test_a_comma_may_be_part_of_a_name(tmp_path):
    (tmp_path / "a,b.lvm").touch()
    assert parse_labels([f"liver={tmp_path}/a,b.lvm"])["liver"] == [tmp_path / "a,b.lvm"]


@pytest.mark.parametrize(
    ("label", "told"),
    [("liver", "expected TISSUE=FILE"), ("liver=", "at least one"), ("unknown=a", "reserved"), ("=a", "no name")],
)
def test_what_is_no_label_is_told(label, told):
    with pytest.raises(ConfigurationError, match=told):
        parse_labels([label])
