"""Signals of one run in one HDF5 file that MATLAB's h5read opens: plain datasets, one row a trial."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ffl.errors import InputError
from ffl.learn import Trial, UpdateReport
from ffl.recordings import Recording
from ffl.systems.atomic import written_aside
from ffl.systems.state_space import Array

SIGNALS = {"f": "feedforward", "u": "total command", "y": "measured output", "e": "error r - y"}
REPORT = ("seconds", "kkt_residual", "rank", "active", "left_out")
ADDED = ("left_out",)  # by later versions: files of earlier ones do without
TEXT = {"status": 32, "message": 512}


def append_trial(
    path: Path, trial: Trial, reference: Array, units: dict[str, str], names: list[str]
) -> None:
    """Adds a trial to the run's file, which is replaced whole: written aside, synced, renamed.

    The copy makes ten trials of 8000 samples cost 14 MB of writing, and leaves one format to read,
    complete after every trial. It grows with the square of the trials: 200 of 1500 samples cost about 1 GB.
    """
    with written_aside(path) as aside:
        if trial.number > 1:
            shutil.copyfile(path, aside)
        with h5py.File(aside, "a" if trial.number > 1 else "w") as file:
            if trial.number == 1:
                _create(file, trial, reference, units, names)
            file.pop("second", None)  # it was run with the parameters of an earlier trial
            _add(file, trial)
        replace_synced(aside, path)


def replace_synced(aside: Path, path: Path) -> None:
    """Renames `aside` to `path` once its bytes, and then the folder's entry, are on disk."""
    with aside.open("rb") as file:
        os.fsync(file.fileno())
    os.replace(aside, path)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _create(
    file: h5py.File, trial: Trial, reference: Array, units: dict[str, str], names: list[str]
) -> None:
    n, t = len(reference), trial.recording.sample_time
    for name, values, unit in (
        ("time", np.arange(n) * t, "s"),
        ("reference", reference, units["y"]),
    ):
        file.create_dataset(name, data=values).attrs["unit"] = unit
    for name, meaning in SIGNALS.items():
        data = file.create_dataset(
            name, (0, n), float, maxshape=(None, n), chunks=(1, max(1, min(n, 1 << 17)))
        )
        data.attrs["unit"] = units["y" if name == "e" else "u" if name == "f" else name]
        data.attrs["meaning"] = meaning
    size = len(trial.theta)
    file.create_dataset(
        "theta", (0, size), float, maxshape=(None, size), chunks=(1, max(1, min(size, 1 << 17)))
    )
    for name in ("error_norm", "feedforward_norm", "cost", *REPORT):
        file.create_dataset(name, (0,), float, maxshape=(None,), chunks=(64,))
    for name, length in TEXT.items():
        file.create_dataset(name, (0,), f"S{length}", maxshape=(None,), chunks=(16,))
    file.create_dataset("parameter_names", data=np.array([name.encode() for name in names]))


def _add(file: h5py.File, trial: Trial) -> None:
    report = trial.update
    row: dict[str, Any] = {
        "f": trial.feedforward,
        "u": trial.recording.u,
        "y": trial.recording.y,
        "e": trial.error,
        "theta": trial.theta,
        "error_norm": trial.error_norm,
        "feedforward_norm": trial.feedforward_norm,
        "cost": trial.cost,
    }
    row |= {name: getattr(report, name) if report else np.nan for name in REPORT}
    row |= {
        name: getattr(report, name).encode()[:size] if report else b""
        for name, size in TEXT.items()
    }
    for name, values in row.items():
        if name in ADDED and name not in file:
            continue
        data = file[name]
        data.resize(trial.number, axis=0)
        data[trial.number - 1] = values


def add_second(
    path: Path, reference: Array, recording: Recording, feedback_only: Recording
) -> None:
    """Adds the run on the second reference: with the learned parameters and with feedback alone."""
    with written_aside(path) as aside:
        shutil.copyfile(path, aside)
        with h5py.File(aside, "a") as file:
            group = file.require_group("second")
            for name, values in (
                ("reference", reference),
                ("f", recording.f),
                ("u", recording.u),
                ("y", recording.y),
                ("e", reference - recording.y),
                ("e_feedback_only", reference - feedback_only.y),
            ):
                group.create_dataset(name, data=values)
        replace_synced(aside, path)


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """The run's file to read from; raises `InputError` where it is missing or damaged."""
    again = f"ffl run {path.parent / 'campaign.toml'} --out {path.parent} --resume"
    if not path.exists():
        raise InputError(f"{path}: is missing; make it again with: {again}")
    try:
        with h5py.File(path, "r") as file:
            yield file
    except PermissionError:
        raise InputError(f"{path}: may not be read; change its permissions") from None
    except (OSError, KeyError, ValueError, IndexError, RuntimeError) as error:
        raise InputError(
            f"{path}: is damaged ({error}); remove it, then make it again with: {again}"
        ) from None


def read_dataset(path: Path, name: str, trial: int | None = None) -> Array:
    """A dataset of the run's file, or its row for `trial` (1-based; -1: the last)."""
    with opened(path) as file:
        data = file[name]
        return data[()] if trial is None else data[trial - 1 if trial > 0 else len(data) + trial]


def read_reports(path: Path) -> list[UpdateReport]:
    """The updates of trials 2, 3, ..."""
    with opened(path) as file:
        held = [name for name in (*REPORT, *TEXT) if name in file or name not in ADDED]
        columns = {name: file[name][1:] for name in held}
    unknown = np.full(len(columns["seconds"]), np.nan)
    return [
        UpdateReport(
            float(columns["seconds"][k]),
            columns["status"][k].decode(),
            float(columns["kkt_residual"][k]),
            int(columns["rank"][k]),
            int(columns["active"][k]),
            columns["message"][k].decode(errors="ignore"),
            float(columns.get("left_out", unknown)[k]),
        )
        for k in range(len(columns["seconds"]))
    ]


def last_trial(path: Path, sample_time: float) -> Trial | None:
    """The last trial on disk, to the last bit as it was; None where there is none."""
    if not path.exists():
        return None
    with opened(path) as file:
        number = len(file["error_norm"])
        r, t = file["reference"][()], file["time"][()]
        f, u, y, e = (file[name][-1] for name in SIGNALS)
        theta, cost = file["theta"][-1], float(file["cost"][-1])
    reports = read_reports(path)
    recording = Recording(t, r, f, u, y, sample_time=sample_time, source=str(path))
    return Trial(number, recording, theta, f, e, cost, reports[-1] if reports else None)


def read_second(path: Path) -> dict[str, Array] | None:
    """The signals on the second reference, None where it was not run."""
    with opened(path) as file:
        return (
            {name: data[()] for name, data in file["second"].items()} if "second" in file else None
        )
