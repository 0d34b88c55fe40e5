"""The function that evaluates all recordings of a data folder, and sends the result as a page."""

from collections.abc import Mapping
from pathlib import Path

from app.analysis.grasp_collection import Corrections, EstimationContext, collect_readable_grasps
from app.host.background_process import SendMessage


def send_evaluation_page(
    send: SendMessage, paths: list[Path], corrections: Corrections, contexts: Mapping[str, EstimationContext]
) -> None:
    """Send one page that compares the answers of each context with what was held.

    Recordings that cannot be read are left out.

    Raises:
        ConfigurationError: no grasp can be judged.
    """
    from app.analysis.evaluation import evaluate_answers  # its charts are not needed by the server that starts this

    groups, left_out = {}, 0
    for name, context in contexts.items():
        groups[name], left_out = collect_readable_grasps(paths, context, corrections)
    about = {"recordings": len(paths) - left_out, "left out": left_out, "libraries": ", ".join(groups)}
    send(evaluate_answers(groups, about).render_page())
