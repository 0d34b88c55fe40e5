"""The base class of all configuration models, and the types of their numbers and names."""

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field


def _check_not_zero(value: float) -> float:
    if value == 0:
        raise ValueError("a factor of 0 leaves nothing")
    return value


Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
NonZero = Annotated[Finite, AfterValidator(_check_not_zero)]
Probability = Annotated[float, Field(gt=0, lt=1)]
Slug = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_]*$")]


class ConfigModel(BaseModel):
    """Base of all configuration models: immutable, no unknown keys, no silent conversion of text to numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    @classmethod
    def complete(cls, content: dict[str, Any]) -> dict[str, Any]:
        """Return a file's content with the values that follow from others; for files, before validation."""
        return content
