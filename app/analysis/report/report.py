"""The class Report of one or several recordings, with its JSON document, and functions that analyze recordings."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import plotly
import scipy

from acquisition.recordings.file_names import to_printable
from acquisition.recordings.mcap_reader import McapFile
from acquisition.recordings.recording import is_mcap
from app import __version__
from app.analysis.report.recording_analyzer import AnalyzedRecording, Progress, analyze_recording, open_recorded_run
from app.analysis.report.statistics import Observation, Statistics, TruthSource, compute_statistics
from app.analysis.report.statistics_tables import build_statistics_tables
from app.analysis.report.tissue_styles import TissueStyle, build_tissue_styles
from app.recordings.answer_advice import explain_missing_answers
from app.recordings.mcap_writer import RecordingContext
from config.schema import Settings, TissueLibrary, Tool
from estimator.estimate_block import GraspRecord
from estimator.studies.html_page import to_json_value

READING_SHARE = 0.85  # of the time that a report takes; rendering the page takes the rest


@dataclass(frozen=True)
class Report:
    """Recordings in reading order; `labels` gives the tissue that was held, by a recording's title."""

    title: str
    recordings: tuple[AnalyzedRecording, ...]
    labels: Mapping[str, str]

    @property
    def library(self) -> TissueLibrary:
        return self.recordings[0].library

    @cached_property
    def grasps(self) -> list[tuple[AnalyzedRecording, GraspRecord, Observation]]:
        """All grasps, each with its recording and its observation for the statistics."""
        return [
            (analyzed, record, self._build_observation(analyzed, record))
            for analyzed in self.recordings
            for record in analyzed.grasps
        ]

    @cached_property
    def statistics(self) -> Statistics:
        return compute_statistics([observation for *_, observation in self.grasps], self.library.tissues)

    @cached_property
    def tissue_styles(self) -> dict[str, TissueStyle]:
        return build_tissue_styles(self.library, tuple(dict.fromkeys(one.group for *_, one in self.grasps)))

    def _build_observation(self, recording: AnalyzedRecording, record: GraspRecord) -> Observation:
        label = self.labels.get(recording.title)
        told = TruthSource.LABEL if label else TruthSource.RECORDING if recording.tissue else TruthSource.VERDICT
        return Observation(recording.title, record, label or recording.tissue, told, recording.force_errors_n(record))

    def document(self) -> dict[str, Any]:
        """Return every figure of the page, ready for JSON: SI units, None where there is no value."""
        found = self.statistics
        return {
            "report": self.title,
            "versions": collect_versions(),
            "library": self.library.name,
            "recordings": [self._recording_document(analyzed) for analyzed in self.recordings],
            "left_out": [
                {"recording": one.source, "grasp": one.record.index, "why": why} for one, why in found.excluded
            ],
            "tables": [
                to_json_value(asdict(table))
                for table in build_statistics_tables(found, self.library, self.tissue_styles)
            ],
            "figure_8": {
                name: to_json_value(
                    dict(zip(("alpha_n", "beta_per_m", "damping_kg_per_s"), np.exp(logs).T.tolist(), strict=True))
                )
                for name, logs in found.log_parameters.items()
            },
            "tukey": {
                parameter: {
                    "why_not": one.skip_reason,
                    "too_small": list(one.too_small_groups),
                    "pairs": [
                        {"pair": list(pair), **to_json_value(asdict(c)), "differs": c.differs}
                        for pair, c in one.pairs.items()
                    ],
                }
                for parameter, one in found.tukey.items()
            },
        }

    def _recording_document(self, recording: AnalyzedRecording) -> dict[str, Any]:
        own = [(record, observation) for told_by, record, observation in self.grasps if told_by is recording]
        return {
            "title": recording.title,
            "facts": to_json_value(recording.facts),
            "tool": recording.tool.name,
            "force_scale": recording.tool.scale_text,
            "samples": len(recording.traces),
            "lost_samples": recording.lost_samples,
            "duration_s": recording.duration_s,
            "held": self.labels.get(recording.title) or recording.tissue,
            "advice": explain_missing_answers(recording.tool, recording.library, recording.grasps),
            "spots": [spot.model_dump() for spot in recording.spots],
            "grasps": [
                {
                    **to_json_value(record.model_dump()),
                    "group": observation.group,
                    "thickness_m": recording.thickness_m.get(record.index),
                    "alarms": [to_json_value(asdict(alarm)) for alarm in recording.grasp_alarms(record)],
                    "withdrawn": [
                        to_json_value(asdict(one)) for one in recording.withdrawals if one.grasp == record.index
                    ],
                }
                for record, observation in own
            ],
        }


def collect_versions() -> dict[str, str]:
    """Return the versions of the packages on which a report's figures depend."""
    return {
        "graspwatch": __version__,
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "plotly": plotly.__version__,
    }


def analyze_recordings(
    files: Sequence[Path],
    tool: Tool,
    library: TissueLibrary,
    settings: Settings,
    labels: Mapping[Path, str],
    progress: Progress,
) -> Report:
    """Open and analyze all recordings, one after the other; return the report. `tool` is that of LabVIEW recordings.

    Raises:
        RecordingError: a recording cannot be read; the text names file and line.
    """
    titles = _make_titles(files)
    recordings = [open_recorded_run(path, tool) for path in files]
    whole, before, analyzed_recordings = sum(recording.sample_count for recording in recordings), 0, []
    for recording in recordings:

        def share(done: float, before: int = before, samples: int = recording.sample_count) -> None:
            progress(READING_SHARE * (before + done * samples) / whole)

        analyzed_recordings.append(analyze_recording(recording, titles[recording.path], library, settings, share))
        before += recording.sample_count
    name = titles[files[0]] if len(files) == 1 else f"{len(files)} recordings"
    return Report(
        f"Report: {name}", tuple(analyzed_recordings), {titles[path]: label for path, label in labels.items()}
    )


def read_common_configuration(files: Sequence[Path]) -> tuple[TissueLibrary, Settings] | None:
    """Return the library and settings that all files were recorded with; None if they differ or a file has none.

    Raises:
        RecordingError: a recording cannot be read.
    """
    containers = [McapFile(path) for path in files if is_mcap(path)]
    rigs = [RecordingContext.from_recording(container) for container in containers]
    alike = len(rigs) == len(files) and all(
        (r.library, r.settings) == (rigs[0].library, rigs[0].settings) for r in rigs
    )
    return (rigs[0].library, rigs[0].settings) if alike else None


def _make_titles(files: Sequence[Path]) -> dict[Path, str]:
    """Return file names as titles, or paths where names are the same."""
    names = [path.name for path in files]
    return {path: to_printable(path.name if names.count(path.name) == 1 else str(path)) for path in files}
