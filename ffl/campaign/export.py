"""Learned feedforward for other programs: sections (JSON), a C header, a MAT file, a table."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ffl.bases import (
    FIR,
    OBF,
    Basis,
    Combination,
    Derivatives,
    Filter,
    Friction,
    SumBasis,
    basis_kind,
)
from ffl.bases.friction import STANDS
from ffl.bases.obf import all_pass
from ffl.campaign.c_header import WRITTEN, c_header
from ffl.campaign.config import Campaign, RunSpec, load_campaign
from ffl.campaign.signals import read_dataset
from ffl.campaign.store import read_results
from ffl.errors import InputError
from ffl.systems.atomic import require_replaceable, write_bytes, write_text
from ffl.systems.plant_file import suggest
from ffl.systems.state_space import Array, ComplexArray

HOW = (
    "f(t) = sum_k taps.gain[k] r(t - taps.delay[k]) + forwards + backwards + friction; outside its "
    "samples r stays at its first and last value. forwards: sections in series, t = 0 .. N-1, the "
    "first one fed with v = r(t): f += gain . x, w = c . x + d v, x = a x + b v, w feeds the next. "
    "backwards: the same for t = N-1 .. 0, but x is moved on before f += gain . x. Each x begins at "
    "rest: x = rest times r(0), backwards r(N-1). friction, each with s(t) times level_positive where "
    "s(t) > 0, else times level_negative: v(t) = (r(t+1) - r(t-1)) / (2 sample_time); where velocity "
    "> 0, s = v / velocity, held within -1 .. 1; where velocity = 0, s = sign(v), and s = 0 where "
    "|v(t)| <= stands times the largest |v| of the whole reference, since there it stands but for "
    "rounding."
)


@dataclass(frozen=True)
class Section:
    """All-pass section of two states (one and a zero): x+ = a x + b v, w = c x + d v."""

    a: Array
    b: Array
    c: Array
    d: float
    gain: Array
    rest: Array

    def table(self) -> dict[str, Any]:
        return {
            name: np.asarray(getattr(self, name)).tolist()
            for name in ("a", "b", "c", "d", "gain", "rest")
        }


@dataclass(frozen=True)
class Realisation:
    """A learned feedforward as a filter; see `HOW`."""

    sample_time: float
    delays: tuple[int, ...]
    gains: tuple[float, ...]
    forwards: tuple[Section, ...]
    backwards: tuple[Section, ...]
    friction: tuple[dict[str, float], ...]

    def table(self) -> dict[str, Any]:
        return {
            "taps": {"delay": list(self.delays), "gain": list(self.gains)},
            "forwards": [section.table() for section in self.forwards],
            "backwards": [section.table() for section in self.backwards],
            "friction": list(self.friction),
        }


def realise(basis: Basis, theta: Array) -> Realisation:
    """The filter F(theta); `InputError` for a basis that is not a filter of the reference."""
    parts = list(_parts(basis, theta))
    taps: dict[int, float] = {}
    forwards: list[Section] = []
    backwards: list[Section] = []
    friction: list[dict[str, float]] = []
    for part, own in parts:
        if isinstance(part, OBF):
            count = len(part.forward_poles)
            forwards += _sections(part.forward_poles, own[:count], part.sample_time)
            backwards += _sections(part.backward_poles, own[count:], part.sample_time)
        elif isinstance(part, Filter):
            for k, tap in enumerate(part.taps, part.first):
                taps[k] = taps.get(k, 0.0) + float(own[0] * tap)
        elif isinstance(part, (FIR, Derivatives)):
            for delay, gain in _taps(part, own).items():
                taps[delay] = taps.get(delay, 0.0) + gain
        elif isinstance(part, Friction):
            friction.append(
                {
                    "level_positive": float(own[0]),
                    "level_negative": float(own[-1]),
                    "velocity": part.velocity,
                    "stands": STANDS,
                    "sample_time": part.sample_time,
                }
            )
        else:
            raise InputError(
                f"basis '{basis_kind(part)}' is not a filter of the reference; export csv or mat"
            )
    if sum(isinstance(part, OBF) for part, _ in parts) > 1:
        raise InputError("export of more than one 'obf' table is not possible; join their poles")
    delays = tuple(sorted(taps))
    gains = tuple(taps[k] for k in delays)
    sections = tuple(forwards), tuple(backwards)
    return Realisation(basis.sample_time, delays, gains, *sections, tuple(friction))


def _parts(basis: Basis, theta: Array) -> Iterator[tuple[Basis, Array]]:
    """The bases that `basis` is made of, each with its own parameters; what is combined, taken apart."""
    if isinstance(basis, Combination):
        yield from _parts(basis.basis, theta[0] * basis.theta)
    elif isinstance(basis, SumBasis):
        first = 0
        for part in basis.parts:
            yield from _parts(part, theta[first : first + part.n_parameters])
            first += part.n_parameters
    else:
        yield basis, theta


def _sections(poles: ComplexArray, theta: Array, sample_time: float) -> list[Section]:
    found: list[Section] = []
    position, level = 0, 1.0
    for pole in poles:
        if pole.imag < 0:
            continue
        system = all_pass(complex(pole), sample_time)
        n = system.order
        a, b, c, gain, rest = np.zeros((2, 2)), np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2)
        a[:n, :n], b[:n], c[:n] = system.a, system.b[:, 0], system.c[0]
        d = float(system.d[0, 0])
        gain[:n] = theta[position : position + n]
        rest[:n] = np.linalg.solve(np.eye(n) - system.a, system.b[:, 0] * level)
        level = float(c @ rest + d * level)
        found.append(Section(a, b, c, d, gain, rest))
        position += n
    return found


def _taps(basis: FIR | Derivatives, theta: Array) -> dict[int, float]:
    """Impulse response of a basis of finite length."""
    reach = 2 + (max(map(abs, basis.delays)) if isinstance(basis, FIR) else 4)
    pulse = np.zeros(4 * reach + 1)
    pulse[2 * reach] = 1.0
    response = basis.regressors(pulse) @ theta
    return {int(k) - 2 * reach: float(response[k]) for k in np.flatnonzero(response)}


def export_run(folder: Path, run: str, format: str, out: Path) -> None:
    """Writes the last trial's feedforward of a finished run; over an earlier export of that format only."""
    if format not in FORMATS:
        raise InputError(f"format '{format}': {suggest(format, list(FORMATS))}")
    if out.is_dir():
        raise InputError(f"{out}: is a folder; give a file for --out")
    if not (folder / "campaign.toml").is_file():
        raise InputError(f"{folder}: no campaign.toml; give the folder of a run")
    campaign = load_campaign(folder / "campaign.toml")
    spec = campaign.run(run)
    path = folder / f"{run}.h5"
    if not path.exists() and not _told(folder, run):
        raise InputError(f"{folder}: run '{run}' has no trial yet; finish it with --resume")
    require_replaceable(out, partial(OWN[format], campaign))
    FORMATS[format](campaign, spec, path, out)


def _told(folder: Path, run: str) -> bool:
    """Whether results.json tells of trials of the run."""
    if not (folder / "results.json").is_file():
        return False
    return any(e["name"] == run and e["error_norm"] for e in read_results(folder)["runs"])


def _json(campaign: Campaign, run: RunSpec, path: Path, out: Path) -> None:
    theta = read_dataset(path, "theta", -1)
    realisation = realise(run.basis, theta)
    document = {
        "schema": 1,
        "campaign": campaign.name,
        "run": run.name,
        "sample_time": campaign.sample_time,
        "units": {
            "reference": campaign.model.output_unit,
            "feedforward": campaign.model.input_unit,
        },
        "parameters": [
            {"name": name, "value": float(value)}
            for name, value in zip(run.basis.names, theta, strict=True)
        ],
        "how": HOW,
        **realisation.table(),
    }
    write_text(out, json.dumps(document, indent=1, allow_nan=False) + "\n")


def _table(campaign: Campaign, run: RunSpec, path: Path, out: Path) -> None:
    columns = (campaign.time, campaign.reference, read_dataset(path, "f", -1))
    rows = zip(*(column.tolist() for column in columns), strict=True)
    write_text(out, "t,r,f\n" + "".join(f"{t!r},{r!r},{f!r}\n" for t, r, f in rows))


def _mat(campaign: Campaign, run: RunSpec, path: Path, out: Path) -> None:
    import io

    from scipy.io import savemat

    buffer = io.BytesIO()
    savemat(
        buffer,
        {
            "t": campaign.time,
            "r": campaign.reference,
            "f": read_dataset(path, "f", -1),
            "theta": read_dataset(path, "theta", -1),
            "names": np.array(run.basis.names, dtype=object),
            "sample_time": campaign.sample_time,
            "run": run.name,
        },
        oned_as="column",
    )
    write_bytes(out, buffer.getvalue())


def _c(campaign: Campaign, run: RunSpec, path: Path, out: Path) -> None:
    realisation = realise(run.basis, read_dataset(path, "theta", -1))
    told = f"campaign {campaign.name}, run {run.name}, sample time {campaign.sample_time!r} s"
    write_text(out, c_header(realisation, told))


FORMATS: dict[str, Callable[[Campaign, RunSpec, Path, Path], None]] = {
    "json": _json,
    "c": _c,
    "mat": _mat,
    "csv": _table,
}


def _own_json(campaign: Campaign, content: bytes) -> bool:
    try:
        document = json.loads(content)
    except ValueError:
        return False
    return isinstance(document, dict) and document.get("how") == HOW


def _own_c(campaign: Campaign, content: bytes) -> bool:
    return content.split(b"\n")[0].endswith(WRITTEN.encode())


def _own_mat(campaign: Campaign, content: bytes) -> bool:
    import io

    from scipy.io import whosmat

    try:
        names = {name for name, _, _ in whosmat(io.BytesIO(content))}
    except Exception:  # whatever the reader makes of another format
        return False
    return names == {"t", "r", "f", "theta", "names", "sample_time", "run"}


def _own_table(campaign: Campaign, content: bytes) -> bool:
    """t and r must be the campaign's: other tables of t, r and f are somebody's work."""
    rows = zip(campaign.time.tolist(), campaign.reference.tolist(), strict=True)
    starts = ["t,r,f", *(f"{t!r},{r!r}," for t, r in rows)]
    lines = content.decode(errors="replace").splitlines()
    return len(lines) == len(starts) and all(map(str.startswith, lines, starts))


OWN: dict[str, Callable[[Campaign, bytes], bool]] = {
    "json": _own_json,
    "c": _own_c,
    "mat": _own_mat,
    "csv": _own_table,
}
