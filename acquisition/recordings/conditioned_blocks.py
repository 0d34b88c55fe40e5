"""The function that yields the blocks of a recording, conditioned like those of a live tool."""

from collections.abc import Callable, Iterator

from acquisition.recordings.recording import RecordingSource
from acquisition.sample_block import SampleBlock
from acquisition.signals.pipeline import ConditioningPipeline
from config.schema import ConditioningSettings, Tool


def read_conditioned_blocks(
    recording: RecordingSource, tool: Tool, conditioning: ConditioningSettings, progress: Callable[[float], None]
) -> Iterator[SampleBlock]:
    """Yield the conditioned blocks of a recording to its end; `progress` receives the share done after each.

    Raises:
        RecordingError: the file is damaged; the text names the place.
    """
    pipeline, done = ConditioningPipeline(tool, conditioning), 0
    with recording:
        while (raw := recording.read_block()) is not None:
            yield pipeline.process(raw)
            done += len(raw)
            progress(done / recording.sample_count)
