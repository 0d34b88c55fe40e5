"""Names of tissues: each that is accepted works in all formats, each other is refused when it is entered."""

import re
from pathlib import Path

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.sample_block import SAMPLE_DTYPE, dtype_field_names
from config.errors import ConfigurationError
from config.load import CONFIG_DIR, load_library
from config.tissue_names import COLUMN_NAMES, MAX_LENGTH, check_tissue_names, find_name_fault, normalize_tissue_name
from estimator.estimate_rows import estimate_layout

MATLAB_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")
typed = st.text("abz01_ -AÄ", min_size=1, max_size=MAX_LENGTH + 3)


def column_names(tissues: list[str]) -> list[str]:
    """All columns of an export of samples with these tissues."""
    estimated = [column.path.replace(".", "_") for column in estimate_layout(tissues).columns if column.path != "tick"]
    return ["time_s", "utc_ns", *dtype_field_names(SAMPLE_DTYPE), *estimated]


@settings(deadline=None)
@given(st.lists(typed, min_size=1, max_size=5))
def test_names_that_are_accepted_are_names_of_messages_of_columns_and_of_variables(texts: list[str]) -> None:
    try:
        tissues = list(dict.fromkeys(normalize_tissue_name(text, "--label") for text in texts))
        check_tissue_names(tissues, "--label")
    except ConfigurationError:
        return
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(estimate_layout(tissues).descriptor_set).file:
        pool.Add(file)  # pyright: ignore[reportAttributeAccessIssue]
    assert set(pool.FindMessageTypeByName("graspwatch.Estimates").fields_by_name) >= set(tissues)
    names = column_names(tissues)
    assert len(set(names)) == len(names)
    assert all(MATLAB_NAME.fullmatch(name) for name in names)


@pytest.mark.parametrize(
    ("text", "name"),
    [("Liver", "liver"), ("small bowel", "small_bowel"), ("small-bowel", "small_bowel"), (" Vessel 2 ", "vessel_2")],
)
def test_a_name_may_be_typed_as_people_write_it(text: str, name: str) -> None:
    assert normalize_tissue_name(text, "--tissue") == name


@pytest.mark.parametrize(
    "text", ["", "2nd_liver", "_liver", "liver!", "Leber (links)", "läber", "a" * 31, "unknown", "tick"]
)
def test_a_name_that_would_not_work_somewhere_is_refused(text: str) -> None:
    with pytest.raises(ConfigurationError, match=r"^--tissue: "):
        normalize_tissue_name(text, "--tissue")


def test_no_tissue_gives_two_columns_one_name() -> None:
    """The names that are kept for columns are all that would collide."""
    fixed, suffixes = (
        column_names([]),
        [name.removeprefix("x_") for name in column_names(["x"]) if name.startswith("x_")],
    )
    fixed_rows = [column.path for column in estimate_layout([]).columns]
    collide = {name.removesuffix(f"_{end}") for name in fixed for end in suffixes if name.endswith(f"_{end}")}
    assert collide | set(fixed_rows) == set(COLUMN_NAMES)
    assert all(find_name_fault(name) for name in COLUMN_NAMES)


@pytest.mark.parametrize(
    ("name", "told"),
    [("2nd_liver", "with a letter first"), ("jaw", "names of other columns"), ("small__bowel", "differ only in")],
)
def test_a_library_with_such_a_name_is_refused_when_it_is_loaded(tmp_path: Path, name: str, told: str) -> None:
    text = (CONFIG_DIR / "tissues" / "porcine.toml").read_text(encoding="utf-8")
    path = tmp_path / "mine.toml"
    path.write_text(text.replace("[tissues.liver", f"[tissues.{name}"), encoding="utf-8")
    with pytest.raises(ConfigurationError, match=told) as refused:
        load_library(str(path))
    assert str(refused.value).startswith(str(path))
