"""Units that a header or a plant file may name, where two of them are known to measure the same."""

from __future__ import annotations

import math

_PREFIX = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "": 1.0, "k": 1e3}
_TURN = {"rad": 1.0, "deg": math.pi / 180.0, "°": math.pi / 180.0, "rev": 2.0 * math.pi}
_LENGTH = {**{f"{p}m": f for p, f in _PREFIX.items()}, "cm": 1e-2, "in": 0.0254, "inch": 0.0254}
_ANGLE = {
    **_TURN,
    "mrad": 1e-3,
    "urad": 1e-6,
    "mdeg": 1e-3 * _TURN["deg"],
    "arcmin": _TURN["deg"] / 60.0,
    "arcs": _TURN["deg"] / 3600.0,  # as `plain` has arcsec
}
_RATE = {
    "rpm": 2.0 * math.pi / 60.0,
    "rev/min": 2.0 * math.pi / 60.0,
    "1/min": 2.0 * math.pi / 60.0,
}

# What each measures, and how much of it.
KNOWN: dict[str, tuple[str, float]] = {
    **{name: ("length", f) for name, f in _LENGTH.items()},
    **{name: ("angle", f) for name, f in _ANGLE.items()},
    **{f"{name}/s": ("speed", f) for name, f in _LENGTH.items()},
    **{f"{name}/min": ("speed", f / 60.0) for name, f in _LENGTH.items()},
    "km/h": ("speed", 1e3 / 3600.0),
    **{f"{name}/s": ("rate", f) for name, f in _ANGLE.items()},
    **{name: ("rate", f) for name, f in _RATE.items()},
    **{
        f"{p}{name}": (name, f)
        for name in ("V", "A", "N", "Nm", "Pa", "W")
        for p, f in _PREFIX.items()
    },
    "MPa": ("Pa", 1e6),
    "bar": ("Pa", 1e5),
}

# Factors that a mistaken unit leaves between what was meant and what was taken.
FACTORS = {
    "a thousand": 1000.0,
    "a million": 1e6,
    "rpm for rad/s": 30.0 / math.pi,
    "degrees for radians": 180.0 / math.pi,
    "turns for radians": 2.0 * math.pi,
    "inches for millimetres": 25.4,
    "inches for metres": 1.0 / 0.0254,
    "km/h for m/s": 3.6,
    "the earth's pull": 9.81,
    "a hundred": 100.0,
    "ten": 10.0,
    "sixty": 60.0,
}
NEAR = 0.02  # of a factor: a model is known to some per cent


def plain(unit: str) -> str:
    """As it is looked up: no brackets or spaces, `u` for micro, no dot in products."""
    out = unit.strip().strip("[]()").replace(" ", "").replace("µ", "u").replace("μ", "u")
    return out.replace("·", "").replace("*", "").replace("sec", "s").replace("r/min", "rpm")


def factor_between(one: str, other: str) -> float | None:
    """How many of `other` one of `one` is; None where either is not known or they measure two things.

    >>> factor_between("mm", "m")
    0.001
    >>> factor_between("counts", "m") is None
    True
    """
    if plain(one) not in KNOWN or plain(other) not in KNOWN:
        return None
    (first, a), (second, b) = KNOWN[plain(one)], KNOWN[plain(other)]
    return a / b if first == second else None


def looks_like(factor: float, near: float = NEAR) -> str:
    """The mistaken units that leave a factor or its inverse, to within the share `near`; else empty."""
    size = abs(math.log(abs(factor)))
    return " or ".join(n for n, known in FACTORS.items() if abs(size - math.log(known)) < near)


def turn_in(unit: str) -> float | None:
    """A full turn in `unit`; None where that measures no angle."""
    return 2.0 * math.pi / _ANGLE[plain(unit)] if plain(unit) in _ANGLE else None
