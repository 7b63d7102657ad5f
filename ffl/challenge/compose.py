"""What a challenge consists of: kinds of cases, drawn by one rule at any size."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ffl.challenge.body import FAMILIES
from ffl.challenge.faults import FAULTS
from ffl.challenge.outside import OUTSIDE
from ffl.challenge.physics import EFFECTS

SINGLES_PER_EFFECT = 6
COUNTS = {"null": 150, "parameter": 60, "several": 80, "outside": 40, "weak": 40, "fault": 40}

# A parameter grown beyond the line between correction and effect cannot be weak, nor can what is
# not an effect below a tenth of a sample.
NEVER_WEAK = (
    "mass_change",
    "viscous_friction",
    "linear_stiffness",
    "input_delay",
    "actuator_lag",
    "saturation",
    "sensor_nonlinearity",
)

# Two that are one: levels by direction hold any constant load, a spring's centre moves with it, and one
# level beside a load is two levels; two levels beside a spring are one, and another centre. Levels by
# position and direction hold any load and any spring, stiffening or preloaded ones too.
ONE_AND_THE_SAME = (
    {"asymmetric_friction", "linear_stiffness"},
    {"asymmetric_friction", "constant_load"},
    {"coulomb_friction", "constant_load"},
    {"linear_stiffness", "constant_load"},
    {"position_dependent_friction", "constant_load"},
    {"position_dependent_friction", "linear_stiffness"},
    {"position_dependent_friction", "hardening_spring"},
    {"position_dependent_friction", "preloaded_spring"},
)


@dataclass(frozen=True)
class Plan:
    """What one case is to be; `machines` in the order in which they are tried."""

    kind: str
    effects: tuple[str, ...] = ()
    machines: tuple[str, ...] = ()
    concealment: str = "none"
    doubt: str = "careful"
    fault: str | None = None
    seed: int = 0


def _machines(effects: tuple[str, ...], rng: np.random.Generator, closed: bool = False) -> tuple:
    names = list(FAMILIES)
    for effect in effects:
        if effect in EFFECTS and EFFECTS[effect].machines:
            names = [n for n in names if n in EFFECTS[effect].machines]
    if closed:
        names = [n for n in names if n != "stiffness"]
    return tuple(map(str, rng.permutation(names)))


def _singles(rng: np.random.Generator) -> list[Plan]:
    plans = []
    for effect, maker in EFFECTS.items():
        for k in range(SINGLES_PER_EFFECT):
            concealment = ("feedback", "noise", "masked")[k % 3]
            if maker.machines == ("stiffness",):
                concealment = "noise" if k % 2 else "none"
            machines = _machines((effect,), rng, concealment in ("feedback", "masked"))
            plans.append(Plan("single", (effect,), machines, concealment))
    return plans


def _several(rng: np.random.Generator, k: int) -> Plan:
    """Two effects, each fourth time three, of different families, that are not one and the same."""
    count = 3 if k % 4 == 3 else 2
    names = [n for n in EFFECTS if n != "sensor_nonlinearity"]
    while True:
        chosen = tuple(map(str, rng.choice(names, count, replace=False)))
        if any(pair <= set(chosen) for pair in ONE_AND_THE_SAME):
            continue
        if len({EFFECTS[n].family for n in chosen}) == count:
            return Plan("several", chosen, _machines(chosen, rng), "masked" if k % 2 else "none")


def compose(seed: int, fraction: float = 1.0) -> list[Plan]:
    """Plans of a whole challenge in random order; a fraction takes the same share of each kind.

    Cost O(cases). The full composition has 554 cases: 144 singles and COUNTS.
    """
    rng = np.random.default_rng([seed, 5])
    groups: dict[str, list[Plan]] = {"single": _singles(rng)}
    everywhere = tuple(FAMILIES)
    closed = tuple(n for n in FAMILIES if n != "stiffness")
    for kind, count in COUNTS.items():
        plans = []
        for k in range(count):
            if kind == "null":
                plan = Plan(kind, (), tuple(map(str, rng.permutation(everywhere))))
            elif kind == "parameter":
                plan = Plan(kind, (), tuple(map(str, rng.permutation(everywhere))), doubt="wrong")
            elif kind == "several":
                plan = _several(rng, k)
            elif kind == "outside":
                name = list(OUTSIDE)[k % len(OUTSIDE)]
                plan = Plan(kind, (name,), tuple(map(str, rng.permutation(everywhere))), "outside")
            elif kind == "weak":
                names = [n for n in EFFECTS if n not in NEVER_WEAK]
                name = str(rng.choice(names))
                plan = Plan(kind, (name,), _machines((name,), rng), "weak")
            else:
                fault = FAULTS[k % len(FAULTS)]
                plan = Plan(kind, (), tuple(map(str, rng.permutation(closed))), fault=fault)
            plans.append(plan)
        groups[kind] = plans
    chosen = []
    for plans in groups.values():
        order = rng.permutation(len(plans))[: math.ceil(fraction * len(plans))]
        chosen += [plans[k] for k in order]
    chosen = [chosen[k] for k in rng.permutation(len(chosen))]
    seeds = rng.integers(2**31, size=len(chosen))
    return [
        Plan(p.kind, p.effects, p.machines, p.concealment, p.doubt, p.fault, int(s))
        for p, s in zip(chosen, seeds, strict=True)
    ]
