"""Recordings of a made-up closed loop, and where the real ones are."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from recording_loops import loop

from ffl.recordings import Recording

WHERE = "get it from nonlinearbenchmark.org (KUKA: github.com/JonasWeigand/Robot_Identification)"


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(1)


@pytest.fixture
def recording(rng) -> Recording:
    return loop(rng)


@pytest.fixture
def real():
    """Path of a real recording by its name under the data folder, or a skip that names it."""
    folder = Path(os.environ.get("FFL_DATA", "../shared/data"))

    def find(name: str) -> Path:
        path = folder / name
        if not path.exists():
            pytest.skip(f"{path} is not there; {WHERE} and name its folder in FFL_DATA")
        return path

    return find


@pytest.fixture(scope="session")
def same_bits():
    return lambda a, b: a.shape == b.shape and a.tobytes() == b.tobytes()
