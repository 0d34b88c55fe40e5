"""The real program, started as a person starts it."""

import ctypes.util
import json
import math
import os
import re
import socket
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from simulation import cut, joined, lvm_text, simulate_raw, write_lvm

from config.load import CONFIG_DIR, load_library

PROGRAM = Path(sys.executable).with_name("graspwatch")
AT_ONCE = 2  # each start costs seconds
TISSUES = ("liver", "small_bowel", "bladder", "gallbladder")
CYCLES = 10
HAS_DRIVER = any(ctypes.util.find_library(name) for name in ("nidaqmx", "nicaiu"))

DOCUMENT_KEYS = {"source", "samples", "lost_samples", "duration_s", "library", "force_scale", "grasps", "spots"}
GRASP_KEYS = {
    "dose_n_s",
    "time_above_s",
    "log_sd",
    "nis",
    "index",
    "start_s",
    "contact_s",
    "end_s",
    "label",
    "probability",
    "probabilities",
    "time_to_decision_s",
    "alpha_n",
    "beta_per_m",
    "damping_kg_per_s",
    "peak_force_n",
    "peak_displacement_m",
    "convergence_s",
    "force_error_n",
    "valid",
    "why_invalid",
    "held_back",
    "peak_share_of_limit",
}


@dataclass(frozen=True)
class Answer:
    """What a person got; `told` is the error output with its lines joined."""

    code: int
    out: str
    err: str

    @property
    def told(self) -> str:
        return " ".join(self.err.split())

    @property
    def document(self) -> Any:
        def not_json(token: str) -> None:
            raise AssertionError(f"{token} is no JSON")

        return json.loads(self.out, parse_constant=not_json)


def graspwatch(*arguments: str | Path, columns: int = 200) -> Answer:
    plain = {"COLUMNS": str(columns), "NO_COLOR": "1", "TERM": "dumb"}
    done = subprocess.run(
        [PROGRAM, *arguments],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        stdin=subprocess.DEVNULL,
        env={**os.environ, **plain},
    )
    assert "Traceback" not in done.stderr + done.stdout, done.stderr
    return Answer(done.returncode, done.stdout, done.stderr)


def each(calls: Mapping[str, tuple[str | Path, ...]]) -> dict[str, Answer]:
    with ThreadPoolExecutor(AT_ONCE) as pool:
        return dict(zip(calls, pool.map(lambda call: graspwatch(*call), calls.values()), strict=True))


# --- run --------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def runs() -> dict[str, Answer]:
    wanted = ("run", "trapezoid_2hz", "--json", "--cycles", str(CYCLES), "--seed")
    return each(
        {
            **{tissue: (*wanted, "6", "--tissue", tissue) for tissue in TISSUES},
            "bladder again": (*wanted, "6", "--tissue", "bladder"),
        }
    )


def labels(document: dict[str, Any]) -> Counter[str]:
    return Counter(grasp["label"] for grasp in document["grasps"])


@pytest.mark.parametrize("tissue", TISSUES)
def test_a_run_prints_one_json_document_with_exactly_the_promised_keys(runs: dict[str, Answer], tissue: str) -> None:
    assert runs[tissue].code == 0
    assert runs[tissue].err == ""
    document = runs[tissue].document
    assert set(document) == DOCUMENT_KEYS
    assert document["source"] == f"simulated:{tissue}"
    assert document["library"] == "porcine"
    assert document["lost_samples"] == 0
    assert document["samples"] == pytest.approx(1000 * (0.5 + CYCLES * 1.25), abs=5)  # in blocks of 5
    assert document["duration_s"] == pytest.approx(document["samples"] / 1000)
    assert [grasp["index"] for grasp in document["grasps"]] == list(range(1, CYCLES + 1))
    for grasp in document["grasps"]:
        assert set(grasp) == GRASP_KEYS
        assert set(grasp["convergence_s"]) == set(grasp["force_error_n"]) == set(TISSUES)


@pytest.mark.parametrize("tissue", TISSUES)
def test_probabilities_are_of_all_tissues_and_unknown_and_sum_to_one(runs: dict[str, Answer], tissue: str) -> None:
    for grasp in runs[tissue].document["grasps"]:
        probabilities = grasp["probabilities"]
        assert set(probabilities) == {*TISSUES, "unknown"}
        assert all(0 <= probability <= 1 for probability in probabilities.values())
        assert math.fsum(probabilities.values()) == pytest.approx(1.0, abs=1e-9)
        if grasp["label"] == "undecided":
            assert grasp["probability"] is None
            assert grasp["time_to_decision_s"] is None
        else:
            assert grasp["probability"] == probabilities[grasp["label"]] == max(probabilities.values())
            assert 0 <= grasp["time_to_decision_s"] <= grasp["end_s"] - grasp["contact_s"]


@pytest.mark.parametrize("tissue", TISSUES)
def test_grasps_are_where_the_protocol_put_them_and_as_strong_as_it_asked(runs: dict[str, Answer], tissue: str) -> None:
    for k, grasp in enumerate(runs[tissue].document["grasps"]):
        # a command is set after a block of 5 samples has been read, for the next one; an end is told to 5 samples
        assert grasp["start_s"] == pytest.approx(0.5 + 1.25 * k, abs=0.011)
        assert grasp["end_s"] == pytest.approx(0.5 + 1.25 * k + 0.75, abs=0.011)
        assert grasp["start_s"] < grasp["contact_s"] < grasp["end_s"]
        # 2 V give 1.55 N, read through a filter that leaves some 3 mN of noise and overshoots a step by 4 % at most
        assert 1.54 < grasp["peak_force_n"] < 1.04 * 1.55
        assert grasp["valid"]
        assert grasp["why_invalid"] is None


@pytest.mark.parametrize("tissue", TISSUES)
def test_estimates_of_the_parameters_lie_where_specimens_of_the_tissue_lie(
    runs: dict[str, Answer], tissue: str
) -> None:
    library = load_library("porcine")
    held, beta_per_m = library.compute_apparent_alpha(tissue), library.tissues[tissue].beta_per_m
    named = [grasp for grasp in runs[tissue].document["grasps"] if grasp["label"] == tissue]
    for key, usual, sd in (
        ("alpha_n", held.median_n, held.log_sd),
        ("beta_per_m", beta_per_m, library.spread.log_beta),
    ):
        logs = [math.log(grasp[key] / usual) for grasp in named]
        assert abs(math.fsum(logs) / len(logs)) < 4 * sd  # all grasps are on one spot


@pytest.mark.parametrize("tissue", ["bladder", "gallbladder"])
def test_soft_tissues_are_named_rightly_nearly_always(runs: dict[str, Answer], tissue: str) -> None:
    assert labels(runs[tissue].document)[tissue] >= 8


@pytest.mark.parametrize("tissue", ["liver", "small_bowel"])
def test_liver_and_small_bowel_overlap_but_most_grasps_are_likeliest_right_and_so_are_most_names(
    runs: dict[str, Answer], tissue: str
) -> None:
    document = runs[tissue].document
    likeliest = Counter(
        max(grasp["probabilities"].items(), key=lambda each: each[1])[0] for grasp in document["grasps"]
    )
    assert likeliest[tissue] > CYCLES / 2
    found = labels(document)
    assert found[tissue] > (CYCLES - found["undecided"]) / 2


def test_the_same_seed_gives_the_same_document(runs: dict[str, Answer]) -> None:
    assert runs["bladder again"].out == runs["bladder"].out


# --- replay, tables and files of one's own ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Stand-ins for recordings, and configuration files, good and bad."""
    folder = tmp_path_factory.mktemp("cli")
    gallbladder = joined(simulate_raw("gallbladder", seed=1, cycles=4))
    write_lvm(folder / "gallbladder.lvm", gallbladder)
    write_lvm(folder / "bladder.lvm.gz", joined(simulate_raw("bladder", seed=1, cycles=2)))
    whole, *_, after = cut(gallbladder, [300, 420])
    (folder / "gap.lvm").write_text(lvm_text(whole) + "\n".join(lvm_text(after).splitlines()[24:]) + "\n")

    porcine = (CONFIG_DIR / "tissues/porcine.toml").read_text()
    two = porcine[: porcine.index("[tissues.liver]")] + porcine[porcine.index("[tissues.bladder]") :]
    (folder / "two.toml").write_text(two.replace('name = "porcine"', 'name = "two"'))
    (folder / "bad_library.toml").write_text(two.replace("alpha_pa", "alpha_mpa").replace("0.026", '"thick"'))
    for name in ("tissues", "protocols"):
        (folder / name).mkdir()
    (folder / "tissues/own_two.toml").write_text(two.replace('name = "porcine"', 'name = "own_two"'))
    trapezoid = (CONFIG_DIR / "protocols/trapezoid_2hz.toml").read_text()
    (folder / "protocols/gentle.toml").write_text(trapezoid.replace('name = "trapezoid_2hz"', 'name = "gentle"'))
    (folder / "strong.toml").write_text(trapezoid.replace("peak_v = 2.0", "peak_v = 3.6"))
    settings = (CONFIG_DIR / "graspwatch.toml").read_text()
    (folder / "bad_settings.toml").write_text(settings.replace("port = 8000", 'port = "http"'))
    (folder / "hesitant.toml").write_text(settings.replace("decide_at = 0.95", "decide_at = 0.99"))
    (folder / "other_library.toml").write_text(settings.replace('library = "porcine"', 'library = "porcin"'))
    (folder / "cut.lvm").write_text("\n".join([*lvm_text(gallbladder).splitlines()[:1000], "0.976000\t0.82"]))
    return folder


@pytest.fixture(scope="module")
def others(folder: Path) -> dict[str, Answer]:
    return each(
        {
            "two": (
                "run",
                "trapezoid_2hz",
                "--tissue",
                "gallbladder",
                "--json",
                "--cycles",
                "1",
                "--library",
                folder / "two.toml",
            ),
            "own": (
                "run",
                "gentle",
                "--tissue",
                "gallbladder",
                "--json",
                "--cycles",
                "1",
                "--library",
                "own_two",
                "--data",
                folder,
            ),
            "gap": ("replay", "--json", "--tool", "nidaq", folder / "gap.lvm"),
            "both": ("replay", "--json", "--tool", "nidaq", folder / "gallbladder.lvm", folder / "bladder.lvm.gz"),
        }
    )


@pytest.fixture(scope="module")
def table() -> Answer:
    return graspwatch("run", "trapezoid_4hz", "--tissue", "gallbladder", "--cycles", "2", columns=80)


def test_own_protocols_and_libraries_of_the_data_folder_are_chosen_by_name(others: dict[str, Answer]) -> None:
    document = others["own"].document
    assert (document["library"], len(document["grasps"])) == ("own_two", 1)
    assert document["grasps"][0]["probabilities"] == others["two"].document["grasps"][0]["probabilities"]


def test_without_json_it_prints_a_table_with_a_row_for_each_grasp(table: Answer) -> None:
    assert table.code == 0
    rows = [[cell.strip() for cell in line.strip("│").split("│")] for line in table.out.splitlines()]
    grasps = [row for row in rows if row[0].isdigit()]
    assert [row[0] for row in grasps] == ["1", "2"]
    assert all(row[2].startswith("gall") for row in grasps)
    assert all(re.fullmatch(r"\d+%", row[3]) for row in grasps)
    assert "simulated:gallbladder" in table.out


def test_a_table_names_every_tissue_in_full_on_a_terminal_of_80_columns(table: Answer) -> None:
    assert "│ gallbladder " in table.out


def test_a_run_says_in_which_grasps_the_limiter_held_the_motor_back(runs: dict[str, Answer], table: Answer) -> None:
    strong = ("run", "strong_2hz", "--tissue", "liver", "--cycles", "2")
    held = each({"table": strong, "json": (*strong, "--json")})
    assert [grasp["held_back"] for grasp in held["json"].document["grasps"]] == [True, True]
    assert "The limiter held the motor back in grasps 1, 2" in held["table"].told
    assert held["table"].out.count("held back") == 2
    assert not any(grasp["held_back"] for grasp in runs["gallbladder"].document["grasps"])
    assert "held" not in table.out + table.told


def test_a_table_tells_what_an_undecided_grasp_most_likely_is(folder: Path) -> None:
    """Liver and small bowel overlap too much for one to be 99 % in each of six grasps."""
    asked = ("run", "trapezoid_4hz", "--tissue", "liver", "--cycles", "6", "--config", folder / "hesitant.toml")
    answers = each({"table": asked, "json": (*asked, "--json")})
    rows = [[cell.strip() for cell in line.strip("│").split("│")] for line in answers["table"].out.splitlines()]
    remarks = [row[-1] for row in rows if row[0].isdigit()]
    grasps = answers["json"].document["grasps"]
    assert labels(answers["json"].document)["undecided"] >= 1
    for grasp, remark in zip(grasps, remarks, strict=True):
        tissue, share = max(grasp["probabilities"].items(), key=lambda item: item[1])
        said = [f"likeliest: {tissue.replace('_', ' ')}, {100 * share:.0f} %"] if grasp["label"] == "undecided" else []
        assert remark == "; ".join([*said, *(["held back"] if grasp["held_back"] else [])])


def test_a_library_of_ones_own_is_taken_from_its_file(others: dict[str, Answer]) -> None:
    document = others["two"].document
    assert document["library"] == "two"
    assert set(document["grasps"][0]["probabilities"]) == {"bladder", "gallbladder", "unknown"}
    assert document["grasps"][0]["label"] == "gallbladder"


def test_recordings_are_replayed_as_they_were_made_a_list_of_documents_for_several(
    others: dict[str, Answer], folder: Path
) -> None:
    assert others["both"].code == 0
    first, second = others["both"].document
    assert first["source"] == str(folder / "gallbladder.lvm")
    assert second["source"] == str(folder / "bladder.lvm.gz")
    assert set(first) == set(second) == DOCUMENT_KEYS
    assert first["samples"] == 500 + 4 * 1250
    assert first["lost_samples"] == 0
    assert labels(first)["gallbladder"] >= 3
    assert labels(second)["bladder"] >= 1
    starts = [grasp["start_s"] for grasp in first["grasps"]]
    assert starts == pytest.approx([0.5 + 1.25 * k for k in range(4)], abs=0.006)


def test_samples_missing_from_a_recording_are_counted(others: dict[str, Answer]) -> None:
    document = others["gap"].document
    assert document["lost_samples"] == 120
    assert document["samples"] == 500 + 4 * 1250 - 120
    assert document["duration_s"] == pytest.approx(5.5)
    assert len(document["grasps"]) == 4


def test_another_seed_gives_other_grasps(runs: dict[str, Answer], others: dict[str, Answer]) -> None:
    """Displacement is measured: the library that it is judged by, which differs as well, has no part in it."""
    first, other = (answers.document["grasps"][0] for answers in (runs["gallbladder"], others["two"]))
    assert first["peak_displacement_m"] != other["peak_displacement_m"]


@pytest.mark.recordings
def test_a_tissue_that_is_not_in_the_library_is_never_named_as_one_that_is(recordings: list[Path]) -> None:
    path = next(path for path in recordings if path.name.startswith("ureter4Hz1"))
    document = graspwatch("replay", "--json", path).document
    assert len(document["grasps"]) == 19
    assert set(labels(document)) == {"no_answer"}


# --- refusals ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def taken_port() -> Iterator[int]:
    with socket.create_server(("127.0.0.1", 0)) as other_program:
        yield other_program.getsockname()[1]


@pytest.fixture(scope="module")
def refusals(folder: Path, taken_port: int) -> dict[str, Answer]:
    calls: dict[str, tuple[str | Path, ...]] = {
        "tissue": ("serve", "--tissue", "livr"),
        "protocol": ("run", "trapezoid", "--tissue", "liver"),
        "library": ("serve", "--config", folder / "other_library.toml"),
        "library file": ("run", "sine", "--tissue", "liver", "--library", folder / "bad_library.toml"),
        "settings": ("serve", "--config", folder / "bad_settings.toml"),
        "strong": ("run", folder / "strong.toml", "--tissue", "liver"),
        "recording": ("replay", folder / "none.lvm"),
        "cut recording": ("replay", folder / "cut.lvm"),
        "served fast": ("replay", folder / "gap.lvm", "--tool", "nidaq", "--serve", "--speed", "2"),
        "served as JSON": ("replay", folder / "gap.lvm", "--tool", "nidaq", "--serve", "--json"),
        "port": ("serve", "--port", str(taken_port), "--data", folder / "data"),
        "address": ("serve", "--host", "192.0.2.1", "--port", "0", "--data", folder / "data"),
        "real tissue": ("serve", "--tool", "nidaq", "--tissue", "liver"),
        "recording tool": ("serve", "--tool", "smart_tool_2013"),
        "tool": ("serve", "--tool", "nidaqmx"),
    }
    if not HAS_DRIVER:  # else this would open a real board
        calls["driver"] = ("serve", "--tool", "nidaq", "--port", "0")
    return each(calls)


@pytest.mark.parametrize(
    ("call", "code", "told"),
    [
        ("tissue", 2, r"There is no tissue 'livr'\. Did you mean 'liver'\? There is: liver, small_bowel, bladder, "),
        ("protocol", 2, r"There is no protocol 'trapezoid'\. .*There is: by_hand, reference_grasp, sine, staircase, "),
        ("library", 2, r"There is no tissue library 'porcin'\. Did you mean 'porcine'\?"),
        ("library file", 2, r"4 faults to mend: .*bad_library\.toml: tissues\.bladder\.thickness_m: Input should be"),
        ("library file", 2, r"tissues\.gallbladder\.alpha_mpa: unknown key; did you mean 'alpha_pa'\?"),
        ("settings", 2, r"1 fault to mend: .*bad_settings\.toml: server\.port: .*\(found 'http'\)"),
        ("strong", 5, r"asks for 3\.60 V; the tool 'simulated' allows at most 3\.50 V"),
        ("recording", 3, r"none\.lvm: there is no such file"),
        ("cut recording", 3, r"cut\.lvm, line 1001: expected 6 columns, found 2"),
        ("served fast", 2, r"--serve shows the recording in the dashboard; leave --json, --speed and --reference out"),
        ("served as JSON", 2, r"leave --json, --speed and --reference out"),
        ("port", 6, r"Cannot listen on 127\.0\.0\.1, port \d+: Address already in use\. Choose another with --port"),
        ("address", 6, r"Cannot listen on 192\.0\.2\.1"),
        ("real tissue", 2, r"--tissue and --demo are for the simulated grasper"),
        ("recording tool", 2, r"Use `graspwatch replay FILE --serve`"),
        ("tool", 2, r"There is no tool 'nidaqmx'\. Did you mean 'nidaq'\?"),
        pytest.param(
            "driver",
            4,
            r"install NI-DAQmx from ni\.com, or run with `--tool simulated`",
            marks=pytest.mark.skipif(HAS_DRIVER, reason="NI-DAQmx is installed: this would open a real board"),
        ),
    ],
)
def test_what_cannot_be_done_ends_with_one_message_and_its_exit_code_and_prints_no_result(
    refusals: dict[str, Answer], call: str, code: int, told: str
) -> None:
    answer = refusals[call]
    assert re.search(told, answer.told), answer.err
    assert answer.code == code
    assert answer.out == ""
    assert answer.told.count("Error") == 1


@pytest.mark.parametrize("name", ["mine[old].toml", "mine[/old].toml"])
def test_a_message_names_a_file_with_brackets_in_its_name(tmp_path: Path, name: str) -> None:
    answer = graspwatch("serve", "--config", tmp_path / name)
    assert answer.code == 2
    assert f"{name}: there is no such file" in answer.told


def test_a_long_path_in_a_message_can_be_copied(tmp_path: Path) -> None:
    path = tmp_path / ("a_long_name_" * 8) / "settings.toml"
    assert f"{path}: there is no such file" in graspwatch("serve", "--config", path, columns=80).err


def test_the_tool_that_the_settings_name_is_the_one_that_runs(tmp_path: Path) -> None:
    settings = tmp_path / "settings.toml"
    settings.write_text('tool = "no_such_tool"\n')
    answer = graspwatch("run", "trapezoid_4hz", "--tissue", "bladder", "--cycles", "1", "--json", "--config", settings)
    assert answer.code == 2


# --- help -------------------------------------------------------------------------------------------------------------


def test_every_command_explains_itself_and_the_program_its_exit_codes() -> None:
    answers = each(
        {
            "": ("--help",),
            "serve": ("serve", "--help"),
            "run": ("run", "--help"),
            "replay": ("replay", "--help"),
            "version": ("--version",),
        }
    )
    assert all(answer.code == 0 and answer.err == "" for answer in answers.values())
    assert "not a medical device" in " ".join(answers[""].out.split())
    assert "Exit codes: 0 done, 2 wrong use or configuration, 3 recording, 4 tool, 5 refused, 6" in answers[""].out
    for command in ("serve", "run", "replay"):
        assert command in answers[""].out
        assert f"Example: graspwatch {command}" in answers[command].out
    assert re.fullmatch(r"\d+\.\d+\.\d+\n", answers["version"].out)
