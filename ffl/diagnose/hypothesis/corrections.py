"""What the plant file has, but slightly wrong: the numbers of its linear part and of its effects."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ffl.diagnose.contest.judging import Judged
from ffl.diagnose.contest.line import slight
from ffl.diagnose.hypothesis.amounts import HUNDREDFOLD, LINE, NAMES, of_its_own, own_damping
from ffl.diagnose.hypothesis.coordinate import Coordinate
from ffl.diagnose.hypothesis.linear import APART, Correction, changed_stiffness
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.result import ModelCorrection
from ffl.effects import EFFECTS
from ffl.systems.state_space import Array

HARDLY = 1e-3  # of a sample: a delay or lag below it is no news to anybody
NO_NEWS = 1e-6  # of what the plant file has: a change that no engineer would make
SHARES = ("mass", "damping", "stiffness", APART)  # what y per u at rest, or a stiffness, hangs on
STEP = 1e-2  # of a change that matters: over which a slope is taken
# Numbers of effects that a plant has too.
OWN = {"coefficient": "damping", "stiffness": "stiffness"}
AT_ITS_END = 1e-3  # of a bound: as near to it, a number tells nothing


def corrections(standing: Judged) -> tuple[ModelCorrection, ...]:
    """Numbers of the plant file that were found otherwise by three standard errors or more; a slight
    delay or lag in samples."""
    out = []
    plant = standing.model.base.plant
    damping = own_damping(standing.model)
    process = standing.model.base.is_process
    if process:
        out += _at_rest(standing)
    for c, spread in zip(standing.model.coordinates, standing.spread, strict=True):
        if c.kind == "given" and c.place is None:
            out += _of_stated(standing.model, c.effect, c.name, spread, c.log)
        if c.kind == "effect" and slight(spec := standing.model.effects[c.effect], plant):
            value = float(spec.parameters[c.name]) / plant.sample_time
            error = float(spread / plant.sample_time)
            if value > max(3.0 * error, HARDLY):
                out.append(ModelCorrection(spec.name, value, error, "samples"))
        if c.kind != "correction" or (process and c.name in ("mass", APART)):
            continue
        value = float(standing.model.corrections.get(c.name, 0.0))
        if abs(value) >= 3.0 * spread:
            ends = _at_its_end(c, value)
            out.append(_told(c.name, value, None if ends else float(spread), damping))
    return tuple(c for c in out if abs(c.relative) > NO_NEWS)


def _at_its_end(c: Coordinate | Correction, value: float) -> bool:
    return any(abs(value - end) < AT_ITS_END * abs(end) for end in (c.lower, c.upper))


def beside_maps(model: Model) -> tuple[ModelCorrection, ...]:
    """Those of a `model` that has maps in it, beyond the contract's line, with no error of their own: what
    of a number is the map's slope nobody can tell."""
    damping = own_damping(model)
    values = {k: v for k, v in model.corrections.items() if k != APART}
    if APART in model.corrections:
        values["stiffness"] = changed_stiffness(model.base.simulator.mechanics, model.corrections)
    told = [_told(name, value, None, damping) for name, value in values.items()]
    return tuple(c for c in told if c.unit or abs(c.relative) > LINE)


def _told(name: str, value: float, error: float | None, damping: float) -> ModelCorrection:
    """As a share of what the plant file has; a damping that it has as good as none of by its size."""
    if name == "damping" and abs(value) > HUNDREDFOLD * damping:
        return ModelCorrection(name, value, error, "1/s")
    scale = 1.0 / damping if name == "damping" else 1.0
    return ModelCorrection(name, value * scale, None if error is None else error * scale)


def as_gain(standing: Judged) -> float | None:
    """Change of the drive's gain, where it says the same with one number: all that the machine has of mass,
    damping and stiffness, corrected or named, off by one share s, (1 + gain)(1 + s) = 1. None where they
    are not."""
    model = standing.model
    damping = own_damping(model)
    if damping <= 0.0 or model.base.is_process:
        return None
    shares = {}
    for c, spread in zip(model.coordinates, standing.spread, strict=True):
        spec = model.effects[c.effect] if c.kind == "effect" else None
        if spec is not None and spec.name == NAMES["mass"]:
            shares["mass"] = spec.parameters["change"], float(spread)
        elif spec is not None and c.name in OWN and (share := of_its_own(model, spec)) is not None:
            per = share / float(spec.parameters[c.name])
            shares[OWN[c.name]] = share, abs(per) * float(spread)
        elif c.kind == "correction" and c.name in NAMES:
            scale = damping if c.name == "damping" else 1.0
            shares[c.name] = model.corrections.get(c.name, 0.0) / scale, float(spread) / scale
    if len(shares) < 2 or set(shares) != {c.name for c in model.base.corrections} & set(NAMES):
        return None
    value, error = shares.pop("mass")
    sure = abs(value) > LINE and abs(value) > 10.0 * error
    alike = all(abs(v - value) < 3.0 * np.hypot(e, error) for v, e in shares.values())
    told = all(abs(v) > 3.0 * e for v, e in shares.values())
    return 1.0 / (1.0 + value) - 1.0 if sure and alike and told else None


def _at_rest(standing: Judged) -> list[ModelCorrection]:
    """Of lags in a row, y per u at rest, which mass and stiffness are there together, and of two lags the
    stiffness, which is the product of their rates: by the slopes of both in the numbers that are free."""
    model, mechanics = standing.model, standing.model.base.simulator.mechanics
    names = [c.name if c.kind == "correction" else "" for c in standing.model.coordinates]
    free = {c.name: c for c in model.base.corrections if c.name in names and c.name in SHARES}
    if not free:
        return []

    def told(moved: Mapping[str, float]) -> Array:
        stiffness = changed_stiffness(mechanics, moved)
        return np.array(
            [1.0 / ((1.0 + moved.get("mass", 0.0)) * (1.0 + stiffness)) - 1.0, stiffness]
        )

    values = {**dict.fromkeys(free, 0.0), **model.corrections}
    found = told(values)

    def slope(name: str, step: float) -> Array:
        above, below = (told({**values, name: values[name] + side * step}) for side in (1, -1))
        return (above - below) / (2.0 * step)

    slopes = np.column_stack([slope(name, STEP * c.scale) for name, c in free.items()])
    at = [names.index(name) for name in free]
    spread, alone = standing.spread[at], standing.fit.spread[at]
    # What is left may be no white noise: as much more doubt of all together as of each by itself.
    more = np.divide(spread, alone, out=np.ones(len(at)), where=np.isfinite(alone) & (alone > 0.0))
    whole = slopes * more @ standing.fit.covariance[np.ix_(at, at)] @ (slopes * more).T
    errors = np.sqrt(np.maximum(np.diag(whole), 0.0))
    ends = APART in free and _at_its_end(free[APART], values[APART])  # where its slope is nothing
    kinds = ("gain", "stiffness") if APART in free else ("gain",)
    each = zip(kinds, found, errors, strict=False)
    return [
        ModelCorrection(n, float(v), None if ends else float(e))
        for n, v, e in each
        if abs(v) >= 3.0 * e
    ]


def _of_stated(model: Model, index: int, name: str, spread: float, log: bool):  # type: ignore[no-untyped-def]
    """A number of an effect that the plant file states, found otherwise by more than its error."""
    stated = float(model.base.plant.effects[index].parameters[name])
    found = float(model.stated[index].parameters[name])
    error = spread * found if log else spread
    if stated == 0.0 or abs(found - stated) < 3.0 * error:
        return []
    label = f"{model.stated[index].name}.{name}"
    if abs(found) > HUNDREDFOLD * abs(stated):  # as good as none was stated
        unit = EFFECTS[model.stated[index].name].parameter(name).unit_in(model.base.plant)
        return [ModelCorrection(label, found - stated, abs(error), unit)]
    return [ModelCorrection(label, found / stated - 1.0, abs(error / stated))]


def times_as_much(standing: Judged) -> float:
    """How much more the machine moves per u than the plant file says, mass corrections and changes of mass
    taken together; 1 for a process or an identified model, whose gain is what it was found to be."""
    model = standing.model
    if model.base.is_process or model.base.plant.is_identified:
        return 1.0
    changes = [e.parameters["change"] for e in model.effects if e.name == "mass_change"]
    whole = 1.0 + np.array([model.corrections.get("mass", 0.0), *changes], float)
    gain = 1.0 + model.corrections.get("gain", 0.0)
    return float(gain / max(float(np.prod(whole)), 1e-3))
