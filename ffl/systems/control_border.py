"""python-control objects in and out: only here, and only through zeros, poles, gain or state space."""

from __future__ import annotations

from typing import Any

import numpy as np

from ffl.errors import InputError
from ffl.systems.state_space import StateSpace
from ffl.systems.zpk import Zpk


def to_control(system: Zpk | StateSpace) -> Any:
    """`control.StateSpace` of a proper system (never a transfer function: see python-control #860)."""
    import control

    ss = system if isinstance(system, StateSpace) else system.state_space()
    return control.ss(ss.a, ss.b, ss.c, ss.d, ss.sample_time)


def from_control(system: Any) -> Zpk | StateSpace:
    """A discrete-time SISO `control` object: StateSpace as it is, TransferFunction through zpk.

    Raises `InputError` for continuous time ("did you forget to discretise?") and for several inputs
    or outputs.
    """
    dt = getattr(system, "dt", None)
    if dt is None or dt is True or not dt:
        raise InputError(
            f"control object with dt = {dt}: give a discrete-time system with its sample time; "
            "did you forget to discretise?"
        )
    if (system.ninputs, system.noutputs) != (1, 1):
        raise InputError(
            f"control object with {system.ninputs} inputs and {system.noutputs} outputs: select one pair"
        )
    if hasattr(system, "A"):
        return StateSpace(system.A, system.B, system.C, system.D, float(dt))
    numerator, denominator = system.num[0][0], system.den[0][0]
    numerator = np.trim_zeros(np.asarray(numerator, float), "f")
    return Zpk(system.zeros(), system.poles(), float(numerator[0] / denominator[0]), float(dt))
