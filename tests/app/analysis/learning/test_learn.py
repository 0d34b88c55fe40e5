"""`graspwatch learn` as a person uses it: on recordings of simulated grasps, and on what goes wrong."""

import json
import tomllib
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from simulation import joined, raw_block, simulate_raw, write_lvm
from typer.testing import CliRunner

from acquisition.recordings.recording import RecordingSource
from app.analysis.headless import replay_recording
from app.analysis.learning.library_file import library_to_toml
from app.cli.main import app
from app.recordings.mcap_writer import RecordingContext
from config.errors import ConfigurationError, RecordingError, ServiceError
from config.load import load_library, load_settings, load_tool

BASE, SETTINGS = load_library("porcine"), load_settings()
SIMULATED = ("--tool", "simulated")
GRASPS = 6


def learn(*arguments: object) -> str:
    """What it prints; errors of the program are raised."""
    result = CliRunner().invoke(app, ["learn", *map(str, arguments)])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two recordings of each of two tissues, and what one learns of the first ones."""
    folder = tmp_path_factory.mktemp("learned")
    for tissue in ("bladder", "liver"):
        for seed in (1, 2):
            raw = joined(simulate_raw(tissue, seed=seed, cycles=GRASPS + 1))
            write_lvm(folder / f"{tissue}{seed}.lvm", raw)
    return folder


@pytest.fixture(scope="module")
def learned(folder):
    printed = learn(
        "--label",
        f"bladder={folder}/bladder1.lvm",
        "--label",
        f"liver={folder}/liver1.lvm",
        *SIMULATED,
        "--out",
        folder / "library.toml",
        "--json",
    )
    return load_library(str(folder / "library.toml")), json.loads(printed)


def replayed(path: Path, library, tool_name="simulated"):
    tool = load_tool(tool_name)
    return replay_recording(
        RecordingSource(path, tool), RecordingContext(tool, library, SETTINGS), lambda _: None
    ).grasps


def test_a_library_with_a_reference_grasp_can_be_read_again(folder):
    write_lvm(folder / "empty.lvm", joined(simulate_raw("liver", "reference_grasp", seed=3, cycles=3, empty=True)))
    labels = [f"--label={tissue}={folder}/{tissue}1.lvm" for tissue in ("bladder", "liver")]
    learn(*labels, *SIMULATED, "--reference", folder / "empty.lvm", "--out", folder / "of_that_day.toml")
    [recording] = load_library(str(folder / "of_that_day.toml")).tissues["liver"].learned.recordings
    assert recording.reference.tool == "simulated"
    assert recording.reference.person is None


def test_it_names_the_tissues_of_other_recordings(folder, learned):
    for tissue in ("bladder", "liver"):
        grasps = replayed(folder / f"{tissue}2.lvm", learned[0])
        likeliest = Counter(max(grasp.probabilities.items(), key=lambda each: each[1])[0] for grasp in grasps)
        assert likeliest[tissue] >= GRASPS - 1  # often undecided: it is another spot than the one that was learned
        assert {grasp.label for grasp in grasps} <= {tissue, "undecided"}


def test_an_earlier_library_is_kept_and_what_one_spot_a_tissue_cannot_tell_is_said(folder, learned):
    before = (folder / "library.toml").read_bytes()
    words = ("--label", f"bladder={folder}/bladder1.lvm", *SIMULATED, "--out")
    with pytest.raises(ConfigurationError, match="exists already, and is kept"):
        learn(*words, folder / "library.toml")
    assert (folder / "library.toml").read_bytes() == before
    result = CliRunner().invoke(app, ["learn", *map(str, words), str(folder / "alone.toml")])
    notes = " ".join(result.stderr.split())
    assert "every grasp can only be bladder or unknown" in notes
    assert "no tissue was recorded on two spots at one ramp" in notes


def test_the_library_tells_what_it_was_learned_from(folder, learned):
    library, document = learned
    profile = library.tissues["bladder"].learned
    assert profile.grasps == GRASPS
    assert profile.recordings[0].file == "bladder1.lvm"
    assert len(profile.recordings[0].sha256) == 64
    assert "not preconditioned" in profile.recordings[0].left_out[0]
    assert profile.contact_measured == (library.tissues["bladder"].thickness_m != BASE.tissues["bladder"].thickness_m)
    assert library.learned.calibration == load_tool("simulated").calibration_fingerprint
    assert library.tissues["bladder"].threshold_pa == BASE.tissues["bladder"].threshold_pa
    assert document["tissues"]["liver"]["learned"]["grasps"] == GRASPS


def test_a_report_lies_beside_it(folder, learned):
    page = (folder / "library-report.html").read_text()
    assert "Confusion by name" in page
    assert "Reliability" in page
    assert 'src="http' not in page  # self-contained
    figures = {
        figure["name"]: figure["value"]
        for figure in json.loads((folder / "library-report.json").read_text())["figures"]
    }
    assert 0 <= figures["later grasps: right by the likeliest"] <= 100


def test_what_is_written_reads_as_the_same_library(learned):
    content = tomllib.loads(library_to_toml(learned[0]))
    assert type(learned[0]).model_validate_json(json.dumps(content)) == learned[0]


def test_the_order_of_labels_and_files_does_not_matter(folder):
    files = {name: [folder / f"{name}{seed}.lvm" for seed in (1, 2)] for name in ("bladder", "liver")}
    texts = []
    for turn in (1, -1):
        arguments = []
        for name in list(files)[::turn]:
            arguments += ["--label", f"{name}={files[name][::turn][0]}", files[name][::turn][1]]
        (folder / str(turn)).mkdir()
        learn(*arguments, *SIMULATED, "--out", folder / str(turn) / "either.toml")
        texts.append((folder / str(turn) / "either.toml").read_text())
    assert texts[0] == texts[1]
    report = json.loads((folder / "1" / "either-report.json").read_text())
    assert any(figure["name"].startswith("another recording") for figure in report["figures"])


def test_a_tissue_that_the_base_does_not_know_gets_the_lowest_threshold_aloud(folder):
    result = CliRunner().invoke(
        app, ["learn", "--label", f"spleen={folder}/bladder1.lvm", *SIMULATED, "--out", str(folder / "spleen.toml")]
    )
    assert result.exit_code == 0
    assert "does not know spleen" in result.stderr
    library = load_library(str(folder / "spleen.toml"))
    assert library.lowest_threshold_n == BASE.lowest_threshold_n
    assert "spleen" in library.source


# --- what goes wrong --------------------------------------------------------------------------------------------------


def refused(error: type[Exception], *arguments: object) -> str:
    with pytest.raises(error) as caught:
        learn(*arguments)
    return str(caught.value)


def test_too_few_grasps_say_which_are_missing_and_write_nothing(folder, tmp_path):
    few = write_lvm(tmp_path / "few.lvm", joined(simulate_raw("liver", seed=1, cycles=3)))
    out = tmp_path / "few.toml"
    told = refused(
        ConfigurationError,
        "--label",
        f"liver={few}",
        "--label",
        f"bladder={folder}/bladder1.lvm",
        *SIMULATED,
        "--out",
        out,
    )
    assert "liver: 2 grasps to learn from, 3 missing (3 recorded; 1 left out, first grasp" in told
    assert "--least" in told
    assert "bladder:" not in told
    assert not list(tmp_path.glob("few.*[!m]l"))
    assert {path.name for path in tmp_path.iterdir()} == {"few.lvm"}


def test_a_label_whose_recording_holds_no_grasp_is_told(folder, tmp_path):
    still = write_lvm(tmp_path / "still.lvm", raw_block(np.full(2000, 0.82)))
    told = refused(ConfigurationError, "--label", f"liver={still}", *SIMULATED, "--out", tmp_path / "x.toml")
    assert "liver: 0 grasps" in told
    assert "command never leaves zero" in told


def test_a_recording_under_two_labels_is_told_even_as_a_copy(folder, tmp_path):
    copy = tmp_path / "copy.lvm"
    copy.write_bytes((folder / "bladder1.lvm").read_bytes())
    labels = ("--label", f"bladder={folder}/bladder1.lvm", "--label", f"liver={copy}")
    told = refused(ConfigurationError, *labels, *SIMULATED, "--out", tmp_path / "x.toml")
    assert "same recording" in told
    assert "bladder1.lvm" in told
    assert "leave the other out" in told


def test_a_recording_of_another_tool_is_told(folder, tmp_path):
    raw = joined(simulate_raw("bladder", seed=1, cycles=GRASPS))
    raw.signals["strain_v"][:] += 0.4
    other = write_lvm(tmp_path / "other.lvm", raw)
    labels = ("--label", f"bladder={folder}/bladder1.lvm", other)
    told = refused(RecordingError, *labels, *SIMULATED, "--out", tmp_path / "x.toml")
    assert "another tool or calibration" in told
    assert "--tool" in told


@pytest.mark.parametrize(("content", "told"), [(None, "no such file"), ("nonsense", "LabVIEW Measurement")])
def test_a_file_that_is_missing_or_none_is_told(tmp_path, content, told):
    path = tmp_path / "bad.lvm"
    if content:
        path.write_text(content)
    assert told in refused(RecordingError, "--label", f"liver={path}", "--out", tmp_path / "x.toml")


@pytest.mark.parametrize(
    ("out", "told"), [("missing/x.toml", "cannot be written"), (".", "is a folder"), ("x.txt", ".toml")]
)
def test_where_it_cannot_write_it_says_so_before_it_reads(tmp_path, out, told):
    assert told in refused(ConfigurationError, "--label", "liver=nowhere.lvm", "--out", tmp_path / out)


def test_a_failure_while_writing_leaves_nothing_behind(folder, tmp_path, monkeypatch):
    out = tmp_path / "new.toml"
    monkeypatch.setattr("os.replace", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    told = refused(ServiceError, "--label", f"bladder={folder}/bladder1.lvm", *SIMULATED, "--out", out)
    assert "No space left" in told
    assert not [*tmp_path.iterdir()]


def test_a_library_is_refused_with_a_tool_of_another_calibration(folder, learned):
    path = str(folder / "library.toml")
    result = CliRunner().invoke(app, ["replay", str(folder / "bladder2.lvm"), "--library", path])
    assert isinstance(result.exception, ConfigurationError)
    assert "calibrated otherwise" in str(result.exception)
    assert "--tool" in str(result.exception)


def edited(folder: Path, tmp_path: Path, edit) -> str:
    content = tomllib.loads((folder / "library.toml").read_text())
    edit(content)
    path = tmp_path / "edited.toml"
    import tomlkit

    path.write_text(tomlkit.dumps(content))
    with pytest.raises(ConfigurationError) as caught:
        load_library(str(path))
    return str(caught.value)


def test_a_singular_covariance_is_told_with_its_tissue(folder, learned, tmp_path):
    def twice_the_same(content):
        rows = content["tissues"]["bladder"]["learned"]["loading_covariance"]
        rows[1] = list(rows[0])
        for row in rows:
            row[1] = row[0]

    told = edited(folder, tmp_path, twice_the_same)
    assert "tissues.bladder.learned" in told
    assert "singular" in told
    assert "learn the library anew" in told


def test_a_library_that_is_learned_in_part_is_told(folder, learned, tmp_path):
    assert "bladder" in edited(folder, tmp_path, lambda content: content["tissues"]["bladder"].pop("learned"))
    assert "[learned]" in edited(folder, tmp_path, lambda content: content.pop("learned"))


def test_a_library_of_another_version_is_told(folder, learned, tmp_path):
    def other(content):
        content["learned"]["features"][0] = "something"

    assert "learn it anew" in edited(folder, tmp_path, other)
