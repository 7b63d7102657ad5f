"""The campaign file as pydantic sees it: which keys there are, and of what type."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticCustomError

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=100)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)  # true is no 1, "3" no 3


class MoveForm(Strict):
    start: NotNegative
    distance: Number
    velocity: Positive
    acceleration: Positive
    jerk: Positive
    snap: Positive | None = None


class MovesForm(Strict):
    kind: Literal["moves"]
    moves: Annotated[list[MoveForm], Field(min_length=1)]
    duration: Positive


class MultisineForm(Strict):
    kind: Literal["multisine"]
    band: Annotated[list[NotNegative], Field(min_length=2, max_length=2)]
    rms: Positive
    duration: Positive
    rest: NotNegative = 0.5
    taper: NotNegative = 0.5
    seed: Annotated[int, Field(ge=0)] = 0


class FileForm(Strict):
    kind: Literal["file"]
    file: str
    column: str = "r"
    map: str | None = None
    start: NotNegative = 0.0
    duration: Positive | None = None
    lead_in: NotNegative = 0.0
    lead_out: NotNegative = 0.0


ReferenceForm = Annotated[MovesForm | MultisineForm | FileForm, Field(discriminator="kind")]


class WeightsForm(Strict):
    """Each a number, a list with one value per sample, or a filter table { form = "zpk", ... }."""

    error: Any = 1.0
    feedforward: Any = 0.0
    feedforward_change: Any = 0.0


class ConstraintsForm(Strict):
    """Each a number, [low, high], or lists of lows and highs, one value per sample."""

    feedforward: Any = None
    feedforward_rate: Any = None
    command: Any = None
    parameters: Any = None


def _tables(value: Any) -> Any:
    tables = isinstance(value, list) and value and all(isinstance(part, dict) for part in value)
    if tables or value == "from_diagnosis":
        return value
    raise PydanticCustomError(
        "basis", "give a list of tables, each with its 'kind', or the word \"from_diagnosis\""
    )


BasisForm = Annotated[list[dict[str, Any]] | Literal["from_diagnosis"], BeforeValidator(_tables)]


class RunForm(Strict):
    name: Name
    basis: BasisForm
    weights: WeightsForm
    constraints: ConstraintsForm = ConstraintsForm()
    update: Literal["auto", "closed_form", "osqp", "riccati", "trajectory"] = "auto"


class DiagnosisForm(Strict):
    """References to record for a diagnosis of the stall, beside the trials themselves."""

    fit: Annotated[list[MovesForm | MultisineForm], Field(min_length=1)]
    held_out: Annotated[list[MovesForm | MultisineForm], Field(min_length=1)]


class CampaignForm(Strict):
    name: Name
    seed: Annotated[int, Field(ge=0)] = 0
    trials: Annotated[int, Field(ge=1, le=9999)] = 10
    model: str
    machine: str | None = None
    reference: ReferenceForm
    second_reference: ReferenceForm | None = None
    diagnosis: DiagnosisForm | None = None
    runs: Annotated[list[RunForm], Field(min_length=1)]


class StepForm(Strict):
    """What `ffl step --basis` reads: basis and weights as in a run, and what is documented."""

    name: str = ""
    basis: BasisForm
    weights: WeightsForm
    constraints: ConstraintsForm = ConstraintsForm()
    update: Literal["auto", "closed_form", "osqp"] = "auto"
    documented: dict[str, Number] = {}
