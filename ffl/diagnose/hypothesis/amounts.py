"""What the linear model's own mass, damping and stiffness come to in the contract's terms (INTERFACES.md):
how far each is off, from where on that is an effect, and what it comes to beside an effect of its kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.linear import modal_terms
from ffl.diagnose.hypothesis.model import Model
from ffl.systems.plant import EffectSpec

# A damping that is nothing but rounding (a free mass from czpk poles at 0: 1e-12/s) is no measure of
# what was found: beyond a hundred times the stated one the model has as good as none.
HUNDREDFOLD = 100.0
UNDONE = 0.3  # of a change of mass: what the model's own may take back
LINE = 0.02  # relative mass; share of the RMS force on the plant
NAMES = {"mass": "mass_change", "damping": "viscous_friction", "stiffness": "linear_stiffness"}


def sizes(
    scene: Scene, model: Model, corrections: Mapping[str, float] | None = None
) -> dict[str, float]:
    """Signed size of each of the `corrections` (None: of the model's own), as the model moves, in the
    contract's terms: relative mass, share of RMS force; none for a process, whose gain and lags are
    corrections at any size, and for a model identified from the machine, whose numbers all are."""
    corrections = model.corrections if corrections is None else corrections
    mechanics = model.base.simulator.mechanics
    if not mechanics.modes or model.base.is_process or model.base.plant.is_identified:
        return {}
    mass = mechanics.moving_mass  # damping and stiffness are in force per motion, whatever moves
    runs = [model.simulate(trial) for trial in scene.trials]
    v = np.concatenate([run.v for run in runs])
    x = np.concatenate([run.x for run in runs])
    u = np.concatenate([run.u for run in runs])
    force = float(np.sqrt(np.mean(u**2))) or 1.0
    out = {"mass": corrections.get("mass", 0.0)}
    if mechanics.place is not None and not model.base.states_mass and claims("mass", out["mass"]):
        out["mass"] = _of_lag(model, corrections)
    if "damping" in corrections:
        push = mass * corrections["damping"] * float(np.sqrt(np.mean(v**2)))
        out["damping"] = push / force
    if "stiffness" in corrections:
        k = modal_terms(mechanics, mechanics.modes[0])[1] * mass
        push = k * corrections["stiffness"] * float(np.sqrt(np.mean((x - x.mean()) ** 2)))
        out["stiffness"] = push / force
    return out


def own_damping(model: Model) -> float:
    """What the plant file has of it, per mass (1/s)."""
    mechanics = model.base.simulator.mechanics
    return modal_terms(mechanics, mechanics.modes[0])[0] if mechanics.modes else 0.0


def _of_lag(model: Model, corrections: Mapping[str, float]) -> float:
    """A speed whose plant file states no mass has a gain at rest and a lag, and these are what an engineer
    has slightly wrong: the larger change of the two. (1.5 % of the gain and -2 % of the lag are 3.5 % of a
    mass that nobody stated.)"""
    damping = own_damping(model)
    whole = damping + corrections.get("damping", 0.0)
    mass = corrections.get("mass", 0.0)
    if damping <= 0.0 or whole <= 0.0:
        return mass
    gain = damping / whole - 1.0
    return max(gain, (1.0 + gain) * (1.0 + mass) - 1.0, key=abs)


def claims(name: str, size: float) -> bool:
    """The size is beyond the line in a way that an effect has a name for."""
    return (abs(size) if name == "mass" else size) > LINE


def effect_values(model: Model, name: str) -> dict[str, float]:
    """The correction `name` as the parameters of its effect, input units."""
    mechanics = model.base.simulator.mechanics
    scale = model.base.simulator.force_per_input
    value = model.corrections[name]
    mass = mechanics.moving_mass * scale
    if name == "mass":
        return {"change": value}
    if name == "damping":
        return {"coefficient": mass * value}
    k = modal_terms(mechanics, mechanics.modes[0])[1] * mass
    return {"stiffness": k * value, "centre": 0.0}


def of_its_own(model: Model, spec: EffectSpec) -> float | None:
    """What an added damping or stiffness is of the one that the plant file has; None for other effects, and
    where it has none."""
    name = next((n for n, effect in NAMES.items() if effect == spec.name and n != "mass"), None)
    if name is None or name not in {c.name for c in model.base.corrections}:
        return None
    whole = own_damping(model) if name == "damping" else 1.0
    key, own = next(iter(effect_values(replace(model, corrections={name: whole}), name).items()))
    share = float(spec.parameters[key]) / own if own > 0.0 else np.inf
    return share if abs(share) < HUNDREDFOLD else None


def netted(scene: Scene, model: Model, name: str) -> Model | None:
    """`model` with the effect of the correction `name` and that correction as the one number they are,
    where it is within the line, or less than the model has: an effect that is undone. None where not."""
    if (index := _place(model, name)) is None:
        return None
    corrections = {**model.corrections, name: _both(model, index, name)}
    if claims(name, sizes(scene, model, corrections).get(name, np.inf)):
        return None
    return replace(model.without(index), corrections=corrections)


def undone(model: Model) -> bool:
    """A change of mass that the model's own mass, beyond the line, takes a good part of back: it says where
    the mass is, not how much. (Of a delay and 7 % more mass a stage of three masses had 48 % more at one
    end, 27 % less of all, and a mode.)"""
    if (index := _place(model, "mass")) is None:
        return False
    change, own = float(model.effects[index].parameters["change"]), model.corrections["mass"]
    return change * own < 0.0 and abs(own) > max(LINE, UNDONE * abs(change))


def as_effect(model: Model, name: str) -> Model | None:
    """`model` with the effect of the correction `name` and that correction as the one number they are, all
    of it the effect's: the model's own stays as stated. None where one of the two is not free."""
    if (index := _place(model, name)) is None:
        return None
    key, unit = _unit(model, name)
    values = {**model.effects[index].parameters, key: unit * _both(model, index, name)}
    corrections = {k: v for k, v in model.corrections.items() if k != name}
    other = replace(model, corrections=corrections, held=model.held | {name})
    return other.with_parameters(index, values)


def _place(model: Model, name: str) -> int | None:
    """Which effect is of the kind of the correction `name`; None unless both are free."""
    if NAMES[name] not in model.names or name in model.held or name not in model.corrections:
        return None
    return model.names.index(NAMES[name])


def _both(model: Model, index: int, name: str) -> float:
    """What the correction `name` and effect `index` of its kind come to, as a correction. (A change of mass
    is one of the corrected mass: 0.77 times 1.299 of it are all of it.)"""
    key, unit = _unit(model, name)
    own, more = model.corrections[name], float(model.effects[index].parameters[key]) / unit
    return own + more + (own * more if name == "mass" else 0.0)


def _unit(model: Model, name: str) -> tuple[str, float]:
    """(the effect's number, what it is of a correction `name` of 1)."""
    unit = replace(model, corrections={**model.corrections, name: 1.0})
    return next(iter(effect_values(unit, name).items()))
