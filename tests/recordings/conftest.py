"""Recordings of a made-up closed loop, and where the real ones are."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from recording_loops import loop

from ffl.errors import InputError
from ffl.recordings import Recording, read_recording

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


@pytest.fixture
def refused():  # type: ignore[no-untyped-def]
    """Asserts that a file is refused in one line: which file, what (`said`, a pattern), and how to mend."""

    def check(path, said):  # type: ignore[no-untyped-def]
        with pytest.raises(InputError, match=said) as error:
            read_recording(path)
        line = str(error.value)
        assert line.startswith(str(path))
        assert "\n" not in line
        assert "; " in line, "says how to mend"

    return check
