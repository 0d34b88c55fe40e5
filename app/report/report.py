"""A report of one recording or of many: read, compared, and written as a page and as JSON."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import plotly
import scipy

from acquisition.recordings.container import Container
from acquisition.recordings.playing import is_mcap
from app import __version__
from app.record.run_file import Rig
from app.report.looks import Look, looks_of
from app.report.statistics import Observation, Statistics, Told, statistics
from app.report.story import Progress, Story, open_recording, story_of
from app.report.tables import statistics_tables
from config.schema import Settings, TissueLibrary, Tool
from estimator.blocks import GraspRecord
from estimator.studies.page import plain

READING = 0.85  # of the time that a report takes; the rest is for the page


@dataclass(frozen=True)
class Report:
    """Stories in the order in which they are to be read; `labels`: what was held, by a story's title."""

    title: str
    stories: tuple[Story, ...]
    labels: Mapping[str, str]

    @property
    def library(self) -> TissueLibrary:
        return self.stories[0].library

    @cached_property
    def grasps(self) -> list[tuple[Story, GraspRecord, Observation]]:
        """All grasps, with what the statistics make of each."""
        return [(story, record, self._observation(story, record)) for story in self.stories for record in story.grasps]

    @cached_property
    def statistics(self) -> Statistics:
        return statistics([observation for *_, observation in self.grasps], self.library.tissues)

    @cached_property
    def looks(self) -> dict[str, Look]:
        return looks_of(self.library, tuple(dict.fromkeys(one.group for *_, one in self.grasps)))

    def _observation(self, story: Story, record: GraspRecord) -> Observation:
        label = self.labels.get(story.title)
        told = Told.LABEL if label else Told.RECORDING if story.tissue else Told.VERDICT
        return Observation(story.title, record, label or story.tissue, told, story.force_errors_n(record))

    def document(self) -> dict[str, Any]:
        """Every figure of the page, ready for JSON: SI units, None where there is no value."""
        found = self.statistics
        return {
            "report": self.title,
            "versions": versions(),
            "library": self.library.name,
            "recordings": [self._recording(story) for story in self.stories],
            "left_out": [
                {"recording": one.source, "grasp": one.record.index, "why": why} for one, why in found.left_out
            ],
            "tables": [plain(asdict(table)) for table in statistics_tables(found, self.library, self.looks)],
            "figure_8": {
                name: plain(
                    dict(zip(("alpha_n", "beta_per_m", "damping_kg_per_s"), np.exp(logs).T.tolist(), strict=True))
                )
                for name, logs in found.values.items()
            },
            "tukey": {
                parameter: {
                    "why_not": one.why_not,
                    "too_small": list(one.too_small),
                    "pairs": [
                        {"pair": list(pair), **plain(asdict(c)), "differs": c.differs} for pair, c in one.pairs.items()
                    ],
                }
                for parameter, one in found.tukey.items()
            },
        }

    def _recording(self, story: Story) -> dict[str, Any]:
        own = [(record, observation) for told_by, record, observation in self.grasps if told_by is story]
        return {
            "title": story.title,
            "facts": plain(story.facts),
            "tool": story.tool.name,
            "force_scale": story.tool.scale_in_words,
            "samples": len(story.traces),
            "lost_samples": story.lost_samples,
            "duration_s": story.duration_s,
            "held": self.labels.get(story.title) or story.tissue,
            "grasps": [
                {
                    **plain(asdict(record)),
                    "group": observation.group,
                    "thickness_m": story.thickness_m.get(record.index),
                    "alarms": [plain(asdict(alarm)) for alarm in story.alarms_of(record)],
                    "withdrawn": [plain(asdict(one)) for one in story.withdrawals if one.grasp == record.index],
                }
                for record, observation in own
            ],
        }


def versions() -> dict[str, str]:
    """Of what a report's figures depend on."""
    return {
        "graspwatch": __version__,
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "plotly": plotly.__version__,
    }


def read_report(
    files: Sequence[Path],
    tool: Tool,
    library: TissueLibrary,
    settings: Settings,
    labels: Mapping[Path, str],
    progress: Progress,
) -> Report:
    """Open all recordings, then take them through the estimator, one after the other; `tool` made LabVIEW's.

    Raises:
        RecordingError: one cannot be read; names file and line.
    """
    titles = _titles(files)
    recordings = [open_recording(path, tool) for path in files]
    whole, before, stories = sum(recording.samples for recording in recordings), 0, []
    for recording in recordings:

        def share(done: float, before: int = before, samples: int = recording.samples) -> None:
            progress(READING * (before + done * samples) / whole)

        stories.append(story_of(recording, titles[recording.path], library, settings, share))
        before += recording.samples
    name = titles[files[0]] if len(files) == 1 else f"{len(files)} recordings"
    return Report(f"Report: {name}", tuple(stories), {titles[path]: label for path, label in labels.items()})


def as_recorded(files: Sequence[Path]) -> tuple[TissueLibrary, Settings] | None:
    """The library and the settings that all these recordings were made with; None where they do not say, or differ.

    Raises:
        RecordingError: one cannot be read.
    """
    containers = [Container(path) for path in files if is_mcap(path)]
    rigs = [Rig.of_file(container) for container in containers]
    alike = len(rigs) == len(files) and all(
        (r.library, r.settings) == (rigs[0].library, rigs[0].settings) for r in rigs
    )
    return (rigs[0].library, rigs[0].settings) if alike else None


def _titles(files: Sequence[Path]) -> dict[Path, str]:
    """File names, with their folders where two are the same."""
    names = [path.name for path in files]
    return {path: path.name if names.count(path.name) == 1 else str(path) for path in files}


def write_whole(path: Path, text: str) -> None:
    """Write a file whole or not at all.

    Raises:
        OSError: it cannot be written.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_text(text, encoding="utf-8")
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
