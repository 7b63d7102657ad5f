"""A number of an answer, and a table of them without what could not be computed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Number:
    """A fitted number; `std_error` None where the data do not see it, or for the reason in `note`."""

    value: Any
    unit: str
    std_error: float | None = None
    note: str = ""

    def answer(self) -> dict[str, Any]:
        """As the contract has it."""
        told = {"value": self.value, "unit": self.unit, "std_error": self.std_error}
        return clean(told | {"note": self.note or None})


def clean(table: dict[str, Any]) -> dict[str, Any]:
    """Without what could not be computed."""
    out = {}
    for key, value in table.items():
        if value is None or (key == "options" and not value):
            continue
        if isinstance(value, float | np.floating):
            if not np.isfinite(value):
                continue
            value = float(value)
        if isinstance(value, list) and any(
            isinstance(v, float) and not np.isfinite(v) for v in value
        ):
            continue
        out[key] = value
    return out
