"""Linear systems: zeros, poles, gain; two-sided filtering; closed loops; references; plant files."""

from ffl.systems.continuous import zero_order_hold
from ffl.systems.control_border import from_control, to_control
from ffl.systems.loop import Controller, Loop, Margins, closed_loop
from ffl.systems.plant import EffectSpec, Imperfections, Physics, Plant
from ffl.systems.plant_file import (
    find_plant,
    load_plant,
    plant_from_dict,
    plant_to_dict,
    save_plant,
)
from ffl.systems.references import Move, moves, multisine
from ffl.systems.state_space import StateSpace, series
from ffl.systems.two_sided import (
    Inversion,
    Split,
    exact_inverse,
    settling_samples,
    split,
    two_sided_filter,
    two_sided_impulse,
)
from ffl.systems.zpk import Zpk, as_state_space, as_zpk

__all__ = [
    "Controller",
    "EffectSpec",
    "Imperfections",
    "Inversion",
    "Loop",
    "Margins",
    "Move",
    "Physics",
    "Plant",
    "Split",
    "StateSpace",
    "Zpk",
    "as_state_space",
    "as_zpk",
    "closed_loop",
    "exact_inverse",
    "find_plant",
    "from_control",
    "load_plant",
    "moves",
    "multisine",
    "plant_from_dict",
    "plant_to_dict",
    "save_plant",
    "series",
    "settling_samples",
    "split",
    "to_control",
    "two_sided_filter",
    "two_sided_impulse",
    "zero_order_hold",
]
