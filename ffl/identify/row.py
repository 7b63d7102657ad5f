"""One line of `ffl reproduce`: our number beside the paper's."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """Our number, over `n` realisations or data sets; `paper` and `std_error` None: there is none."""

    key: str
    what: str
    ours: float
    unit: str
    n: int
    std_error: float | None = None
    paper: float | None = None

    def as_dict(self) -> dict[str, object]:
        """The row as `ffl reproduce --json` states it; what is not known is absent."""
        names = ("key", "what", "paper", "ours", "unit", "std_error", "n")
        return {k: v for k in names if (v := getattr(self, k)) is not None}
