"""A case's plant and recordings from its folder."""

from __future__ import annotations

from pathlib import Path

from ffl.recordings import Recording, read_recording
from ffl.systems import Plant, load_plant


def read_case(folder: Path) -> tuple[Plant, list[Recording], list[Recording]]:
    """plant.toml, the recordings to fit (fit_*) and those that judge (validate_*)."""
    plant = load_plant(str(folder / "plant.toml"))
    fit, validate = (
        [read_recording(p, sample_time=plant.sample_time) for p in sorted(folder.glob(f"{kind}_*"))]
        for kind in ("fit", "validate")
    )
    return plant, fit, validate
