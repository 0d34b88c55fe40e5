"""Every signal of the table is in the recording, in its export, in a replay, and in the frames."""

from pathlib import Path

import numpy as np
import pyarrow.csv

from acquisition.recordings.mcap_layout import CONDITIONED_TOPIC, RAW_TOPIC
from acquisition.recordings.mcap_reader import McapFile
from acquisition.recordings.recording import RecordingSource
from acquisition.signal_table import SENSOR_SIGNALS, SIGNALS
from app.recordings.exchange.export import export_run
from app.recordings.exchange.export_formats import ExportFormat
from app.recordings.run_reader import read_run
from app.stream.frames import build_channels, build_frame_columns
from config.load import load_tool


def test_each_is_in_the_rows_that_the_table_says_with_the_values_of_the_samples(recorded: Path) -> None:
    run, container = read_run(recorded), McapFile(recorded)
    raw, conditioned = (container.read_rows(topic).columns for topic in (RAW_TOPIC, CONDITIONED_TOPIC))
    for signal in SIGNALS:
        for number, columns in ((signal.raw, raw), (signal.conditioned, conditioned)):
            assert (signal.name in columns) == (number is not None)
            if number is not None:
                assert list(columns).index(signal.name) == number - 1
                np.testing.assert_array_equal(columns[signal.name], run.samples[signal.name])


def test_each_is_in_the_export(recorded: Path, tmp_path: Path) -> None:
    run = read_run(recorded)
    export_run(recorded, tmp_path / "run.csv", ExportFormat.CSV)
    table = pyarrow.csv.read_csv(tmp_path / "run.csv")
    for signal in SIGNALS:
        exported = table[signal.name].to_numpy().astype(float)
        np.testing.assert_array_equal(exported, run.samples[signal.name].astype(float))


def test_a_replay_gives_the_sensors_signals_again(recorded: Path) -> None:
    run = read_run(recorded)
    with RecordingSource(recorded, load_tool("simulated")) as replayed:
        blocks = list(iter(replayed.read_block, None))
    for signal in SENSOR_SIGNALS:
        again = np.concatenate([block.signals[signal.name] for block in blocks])
        np.testing.assert_array_equal(again, run.samples[signal.name])


def test_each_that_the_table_sends_is_in_the_frames_with_its_unit(recorded: Path) -> None:
    run = read_run(recorded)
    tissues = list(run.recording_context.library.tissues)
    channels, columns = build_channels(tissues), build_frame_columns(run.samples, run.estimates, len(tissues))
    assert len(channels) == len(columns)
    for signal in SIGNALS:
        found = [
            place for place, channel in enumerate(channels) if (channel.name, channel.tissue) == (signal.name, None)
        ]
        assert found == ([] if signal.frame is None else [signal.frame - 1])
        for place in found:
            assert channels[place].unit == signal.unit
            np.testing.assert_array_equal(columns[place], run.samples[signal.name].astype(np.float32))
