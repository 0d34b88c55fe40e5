"""Messages about grasps: the answer for the one under way, and a finished one."""

from typing import Literal

from pydantic import Field

from app.messages.base import Record
from estimator.force_alarms import Priority


class Identification(Record):
    """The answer for the grasp under way, sent at every change and ten times a second during a grasp."""

    type: Literal["identification"] = "identification"
    server_time_ms: float
    tick: int
    grasp: int = Field(description="0 before the first grasp")
    in_grasp: bool
    in_contact: bool
    label: str
    probability: float | None
    probabilities: dict[str, float]
    time_to_decision_s: float | None
    force_n: float | None
    peak_force_n: float | None
    threshold_n: float = Field(description="Injury threshold in force, for force alarms; no limit of the motor")
    threshold_tissue: str | None = Field(description="Tissue of this threshold; null: the library's lowest one applies")
    limit_n: float | None = Field(description="Limit that the limiter enforces; null: no limit is enforced")
    holding_back: bool = Field(description="Whether the limiter keeps the command lower than the protocol asks for")
    time_to_limit_s: float | None = Field(description="Until the force reaches the limit; null unless it rises")
    thickness_m: float | None = Field(description="Thickness of the tissue, where the tool can measure it at contact")
    convergence_s: dict[str, float | None]
    force_error_n: dict[str, float | None]


class Grasp(Record):
    """A finished grasp. A field without a value is null."""

    index: int
    start_s: float
    contact_s: float | None
    end_s: float
    label: str = Field(description="A tissue's name, `unknown` or `undecided`")
    probability: float | None
    probabilities: dict[str, float]
    time_to_decision_s: float | None
    alpha_n: float | None
    beta_per_m: float | None
    damping_kg_per_s: float | None
    peak_force_n: float | None
    peak_displacement_m: float | None
    convergence_s: dict[str, float | None]
    force_error_n: dict[str, float | None]
    valid: bool
    why_invalid: str | None
    alarms: list[Priority] = Field(description="Force warnings during the grasp: the highest of each rise of the force")
    held_back: bool = Field(description="Whether the limiter kept the command lower than the protocol asks for")
    peak_share_of_limit: float | None = Field(
        default=None,
        description="Highest ratio of the force to the limit enforced at that time; null: no limit was enforced",
    )


class GraspEnded(Record):
    type: Literal["grasp"] = "grasp"
    run_id: str | None
    grasp: Grasp
