"""The reference of a campaign: moves, a multisine, or a column of a recording."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ffl.campaign.forms import FileForm, MovesForm, MultisineForm
from ffl.errors import InputError
from ffl.recordings import Recording, check_recording
from ffl.systems import Move, moves, multisine
from ffl.systems.state_space import Array

ROUNDING = 1e-9
MOST_SAMPLES = 1e8


def find_recording(text: str, folder: Path) -> Path:
    """A recording from the campaign's folder, the working directory, FFL_DATA or ../shared/data."""
    data = os.environ.get("FFL_DATA")
    folders = [folder, Path(), Path(data) if data else Path("..") / "shared" / "data"]
    name, _, part = text.partition("::")
    for base in folders:
        if (base / name).is_file():
            return Path(f"{base / name}::{part}") if part else base / name
    if Path(name).is_dir() or (folder / name).is_dir():
        raise InputError(f"recording '{text}': is a folder; give a file in it")
    places = ", ".join(dict.fromkeys(str(base) for base in folders))
    raise InputError(
        f"recording '{text}': no such file (looked in {places}); mend the name, or set FFL_DATA to the "
        "folder that holds it"
    )


def find_map(text: str | None, folder: Path) -> str | None:
    """A mapping file seen from `folder`, else the name or path as it stands."""
    if text is None:
        return None
    return str(folder / text) if (folder / text).is_file() else text


def build_reference(
    form: MovesForm | MultisineForm | FileForm, sample_time: float, folder: Path
) -> Array:
    """The reference, shape (N,), at rest at its start; raises `InputError` where it is not."""
    if not isinstance(form, FileForm) and form.duration / sample_time > MOST_SAMPLES:
        raise InputError(
            f"reference.duration = {form.duration:g} s holds more than {MOST_SAMPLES:g} samples of "
            f"{sample_time:g} s; shorten it"
        )
    try:
        if isinstance(form, MovesForm):
            sequence = [Move(**move.model_dump()) for move in form.moves]
            return moves(sequence, form.duration, sample_time)
        if isinstance(form, MultisineForm):
            return _multisine(form, sample_time)
    except InputError:
        raise
    except (ArithmeticError, ValueError) as error:
        raise InputError(
            f"reference: a limit is too large or too small to compute with ({error}); give values "
            "of a machine"
        ) from None
    return _from_file(form, sample_time, folder)


def _multisine(form: MultisineForm, sample_time: float) -> Array:
    low, high = form.band
    if low >= high or high > 0.5 / sample_time:
        raise InputError(
            f"reference.band = {form.band} Hz: give [low, high] with low < high <= "
            f"{0.5 / sample_time:g} Hz"
        )
    moving = form.duration - 2 * form.rest
    if moving > 0 and form.taper > 0.5 * moving:
        raise InputError(
            f"reference.taper = {form.taper:g} s is more than half of the {moving:g} s between the "
            "rests; shorten it"
        )
    rng = np.random.default_rng(form.seed)
    return multisine((low, high), form.rms, form.duration, sample_time, rng, form.rest, form.taper)


def _column(form: FileForm, sample_time: float, folder: Path) -> tuple[Path, Array]:
    """The column asked for: of a recording, or of a table that holds no more than t and it."""
    from ffl.recordings.mapping import mapping_beside
    from ffl.recordings.read import read_recording
    from ffl.recordings.readers import open_table

    path = find_recording(form.file, folder)
    mapping = find_map(form.map, folder)
    if mapping is None and "::" not in form.file and mapping_beside(path) is None:
        table = open_table(path)
        alone = table.find("y") is None
        if alone and table.find(form.column) is None:
            there = ", ".join(table.names[:10])
            raise InputError(
                f"reference.column = '{form.column}': {path} does not hold that column (there is {there})"
            )
        if alone and table.find("t") is not None:
            columns = table.numbers(["t", form.column])
            plain = Recording.from_signals(
                sample_time, t=columns["t"], r=columns[form.column], y=columns[form.column],
                source=str(path),
            )  # fmt: skip
            check_recording(plain, sample_time, table.where)
            return path, plain.r
    recording = read_recording(path, mapping, sample_time=sample_time)
    if form.column not in ("r", "y", "f", "u"):
        raise InputError(f"reference.column = '{form.column}': known: r, y, f, u")
    if form.column in recording.missing:
        raise InputError(f"reference.column = '{form.column}': {path} does not hold that column")
    return path, np.asarray(getattr(recording, form.column), float)


def _from_file(form: FileForm, sample_time: float, folder: Path) -> Array:
    path, signal = _column(form, sample_time, folder)
    first = round(form.start / sample_time)
    count = len(signal) if form.duration is None else round(form.duration / sample_time)
    if form.duration is not None and first + count > len(signal) + 1:  # a sample for the fence post
        raise InputError(
            f"reference: start = {form.start:g} s and duration = {form.duration:g} s reach beyond {path}, "
            f"which holds {len(signal) * sample_time:g} s; shorten the duration, or leave it out"
        )
    signal = signal[first : first + count]
    if len(signal) < 8:
        raise InputError(
            f"reference: start = {form.start:g} s"
            + (f" and duration = {form.duration:g} s" if form.duration is not None else "")
            + f" leave {len(signal)} samples of {path}, 8 at least; begin earlier, or take more"
        )
    before = lead(signal, round(form.lead_in / sample_time))
    after = lead(signal[::-1], round(form.lead_out / sample_time), signal[-1])[::-1]
    return np.concatenate([before, signal, after])


def lead(signal: Array, n: int, rest: float = 0.0) -> Array:
    """`n` samples that bring a motion from rest at `rest` to the start of `signal`, smoothly.

    Fifth-order polynomial that meets the signal's position, velocity and acceleration, so that a
    recording cut out of a running motion becomes a reference that starts at rest.
    """
    if n == 0:
        return np.zeros(0)
    window = signal[: min(len(signal), 9)]  # a local cubic: three numbers from a noisy recording
    steps = np.arange(len(window), dtype=float)
    local = np.polynomial.Polynomial.fit(steps, window, 3).convert()
    position, velocity, acceleration = local(0.0), local.deriv()(0.0), local.deriv(2)(0.0)
    s = np.arange(n) / n
    h = position - rest
    v, a = velocity * n, acceleration * n**2
    return (
        rest
        + s**3 * (10.0 * h - 4.0 * v + 0.5 * a)
        + s**4 * (-15.0 * h + 7.0 * v - a)
        + s**5 * (6.0 * h - 3.0 * v + 0.5 * a)
    )


def check_rest(reference: Array, what: str = "reference") -> None:
    """Raises `InputError` unless the reference is finite and begins at rest at zero.

    The trial starts with machine and controller at rest at position zero; a reference that is
    already moving would ask for an infinite acceleration in the first sample.
    """
    if not np.all(np.isfinite(reference)):
        at = int(np.argmin(np.isfinite(reference)))
        raise InputError(f"{what}: sample {at} is not a finite number")
    span = float(np.ptp(reference))
    if span == 0:
        raise InputError(f"{what}: constant, there is nothing to learn from; give it a motion")
    fastest = float(np.abs(np.diff(reference)).max())
    if abs(reference[0]) > ROUNDING * span or abs(reference[1] - reference[0]) > 0.01 * fastest:
        raise InputError(
            f"{what}: does not start at rest at zero (first samples {reference[0]:g}, "
            f"{reference[1]:g}); begin a move later, or give a file reference 'lead_in' seconds"
        )
