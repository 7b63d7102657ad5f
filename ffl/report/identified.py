"""What every method of `ffl identify` is given and hands over."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ffl import __version__
from ffl.recordings import Recording
from ffl.report.page import Page
from ffl.systems import Plant


@dataclass(frozen=True)
class Task:
    """What the command line gave, read and checked."""

    recordings: tuple[Recording, ...]
    model: Plant | None
    basis: Path | None
    n_ac: int
    n_c: int
    orders: tuple[int, ...]


@dataclass(frozen=True)
class Found:
    """JSON facts, the page, and the plant (forward model) or the basis table (inverse) for a campaign.

    `notes`: what must be said with the answer, in sentences.
    """

    facts: dict[str, Any]
    page: Page
    notes: tuple[str, ...] = ()
    plant: Plant | None = None
    basis: dict[str, Any] | None = None


def identified_page(method: str, recording: Recording) -> Page:
    """The page of a method, as it begins."""
    page = Page(
        f"Identification: {method}",
        f"From {recording.source}: {len(recording)} samples of {recording.sample_time * 1e3:g} ms.",
    )
    page.footer = f"Written by ffl {__version__}."
    return page
