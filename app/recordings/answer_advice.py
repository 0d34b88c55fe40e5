"""The function that explains why no grasp of a recording got a name, and what to do."""

from collections import Counter
from collections.abc import Sequence

from config.schema import SourceConditions, TissueLibrary, Tool
from estimator.decision import UNKNOWN
from estimator.estimate_block import GraspRecord
from estimator.loading.constants import REFERENCE_STALL_SD
from estimator.loading.day_comparison import find_incomparable

MAX_THRESHOLD_RATIO = 3.0  # of peak forces to the library's highest threshold; more is hardly the force at the jaws
MIN_PEAK_N = 0.05

# beginning of a grasp's `why_invalid`, and what to look at
_REMEDIES = {
    "encoder slips": "The encoder does not follow the strain gage as `encoder_deg_per_volt` says ({stretch:g} deg/V): "
    "check the encoder's unit and sign, then measure the stretch with `graspwatch calibrate stretch FILE --yes`.",
    "the strain gage is saturated": "The strain gage reaches the end of `analog_range_v` ({range_v:g} V): check the "
    "unit of its column, and that range.",
    "the jaws were shut": "The jaws shut before there is enough to tell: the tissue may be thinner than those learned, "
    "or `encoder_deg_per_volt` ({stretch:g} deg/V) is not that of this tool.",
    "tissue was still held": "The force does not return to rest between grasps: check `rest_offset_v` ({rest_v:g} V).",
    "no contact": "The strain gage rises by less than `force_rise_v` ({rise_v:g} V): check the unit and sign of its "
    "column, and `rest_offset_v` ({rest_v:g} V).",
    "": "Strain and encoder are outside what {kinematics} allow: check their units and signs, and whether the encoder "
    "is at zero with open jaws.",
}


def explain_missing_answers(tool: Tool, library: TissueLibrary, grasps: Sequence[GraspRecord]) -> str | None:
    """Return why no grasp of a recording was named and what to do, or None if one was."""
    if any(grasp.label in library.tissues for grasp in grasps):
        return None
    if not grasps and tool.hand_driven:
        return (
            f"No grasp was found: the jaws never travel by `closing_deg` ({tool.hand_driven.closing_deg:g} deg). Check "
            "the column of `encoder_deg` and its sign, under [table] in the tool file, or lower `closing_deg`."
        )
    if not grasps:
        return (
            f"No grasp was found: the motor command ({tool.channels.motor_command_readback}) never leaves zero. Check "
            "which column it is, under [channels] in the tool file, and its unit."
        )
    share = "The grasp got no name." if len(grasps) == 1 else f"None of the {len(grasps)} grasps got a name."
    invalid = Counter(grasp.why_invalid for grasp in grasps if grasp.why_invalid)
    parts = [share]
    if 2 * invalid.total() >= len(grasps):
        reason, count = invalid.most_common(1)[0]
        parts += [f"{count} of {len(grasps)}: {reason}.", _find_remedy(reason, tool)]
    else:
        parts += _explain_unknown(tool, library, grasps)
    return " ".join(parts)


def explain_missing_reference(tool: Tool, library: TissueLibrary, conditions: SourceConditions) -> str | None:
    """Return why the stall counts less in grasps under these conditions and what to do, or None if it does not."""
    if not (others := find_incomparable(conditions, library)):
        return None
    at, days = conditions.recorded_at, sorted({str(r.recorded_at.date()) for r in others if r.recorded_at})
    lacking = "that has" if conditions.reference is None else "of which the library has"
    return (
        f"{len(others)} recordings of the library {library.name!r} are of another day "
        f"({', '.join(days) or 'not known'}; this one: {at.date() if at else 'not known'}), {lacking} no reference "
        f"grasp. So the stall counts less: it may differ by {REFERENCE_STALL_SD:.0%} from day to day. Name a recording "
        "with empty jaws of that day with --reference"
        + ("; on a live tool, take a reference grasp first." if tool.hand_driven is None else ".")
    )


def _find_remedy(reason: str, tool: Tool) -> str:
    remedy = next(text for beginning, text in _REMEDIES.items() if reason.startswith(beginning))
    calibration = tool.calibration
    return remedy.format(
        stretch=tool.stretch_deg_per_volt,
        range_v=tool.channels.analog_range_v,
        rest_v=calibration.rest_offset_v,
        rise_v=tool.contact.force_rise_v,
        kinematics="[geometry] and `handle_per_encoder`" if tool.geometry else "[kinematics]",
    )


def _explain_unknown(tool: Tool, library: TissueLibrary, grasps: Sequence[GraspRecord]) -> list[str]:
    peaks_n = [grasp.peak_force_n for grasp in grasps if grasp.peak_force_n is not None]
    highest_n = max(library.convert_thresholds_to_displayed_n(tool).values())
    unknown = sum(grasp.label == UNKNOWN for grasp in grasps)
    undecided = len(grasps) - unknown
    if not unknown:
        parts = [f"No tissue of the library {library.name!r} is sure enough."]
    elif not undecided:
        parts = [f"What was held fits no tissue of the library {library.name!r}."]
    else:
        parts = [f"{unknown} fit no tissue of the library {library.name!r}, {undecided} stay undecided."]
    if peaks_n and (max(peaks_n) > MAX_THRESHOLD_RATIO * highest_n or max(peaks_n) < MIN_PEAK_N):
        parts.append(
            f"Their peak forces, {min(peaks_n):.2g} to {max(peaks_n):.2g} N, are far from those that injure the "
            f"library's tissues (up to {highest_n:.2g} N), so the calibration of {tool.name!r} is hardly that of this "
            "tool: name its own tool file with --tool, or measure `newton_per_volt` and the force scale "
            "(docs/hardware.md)."
        )
    elif library.learned is None:
        parts.append(
            f"Their newtons are those of {tool.name!r}, {tool.scale_text.removeprefix('N by ')}: check that it is the "
            "file of this tool (--tool)."
        )
    why = "cannot tell its tissues apart" if undecided > unknown else "does not know this tissue"
    parts.append(
        f"If the tool file is right, the library {why} on this tool: learn from more recordings with `graspwatch learn "
        "--label TISSUE=FILE --label TISSUE=FILE --out mine.toml`, and use it with --library mine.toml."
    )
    return parts
