"""Feedforward parametrizations: one file each, one line in `BASES`."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ffl.bases.arguments import check_arguments
from ffl.bases.base import Basis, SumBasis
from ffl.bases.combination import Combination
from ffl.bases.compensation import Compensation
from ffl.bases.derivatives import Derivatives, derivative
from ffl.bases.filter import Filter
from ffl.bases.fir import FIR
from ffl.bases.free import FreeSignal
from ffl.bases.friction import Friction
from ffl.bases.obf import OBF
from ffl.errors import InputError
from ffl.systems import Plant
from ffl.systems.plant_file import suggest

BASES: dict[str, Callable[..., Basis]] = {
    "combination": Combination,
    "derivatives": Derivatives,
    "filter": Filter,
    "fir": FIR,
    "free": FreeSignal,
    "friction": Friction,
    "from_diagnosis": Compensation,
    "obf": OBF,
}


FROM_DIAGNOSIS = (
    {"kind": "derivatives"},
    {"kind": "from_diagnosis"},
)  # what the bare word stands for


def make_basis(
    specs: Sequence[Mapping[str, Any]] | str, sample_time: float, plant: Plant | None = None
) -> Basis:
    """The basis that the tables of a campaign file describe; a sum where there are several.

    Each table has `kind` and the arguments of that basis; complex poles are [re, im]. The word
    "from_diagnosis" stands for derivatives and the compensation of every effect of `plant`, the
    model; a table {kind = "from_diagnosis"} for the compensations alone. Raises
    `InputError` naming the key within the list, as `[0].poles`.
    """
    if isinstance(specs, str):
        if specs != "from_diagnosis":
            raise InputError(f"'{specs}': the only basis that a word names is 'from_diagnosis'")
        specs = FROM_DIAGNOSIS
    if not specs:
        raise InputError("basis is empty; give at least one table with a 'kind'")
    parts = [_make_one(spec, f"[{index}]", sample_time, plant) for index, spec in enumerate(specs)]
    if len(parts) > 1 and any(isinstance(part, FreeSignal) for part in parts):
        raise InputError("basis kind 'free' holds every other basis; use it alone")
    return parts[0] if len(parts) == 1 else SumBasis(parts)


def basis_kind(basis: Basis) -> str:
    """The `kind` by which a campaign file names the basis; of a sum those of its parts."""
    if isinstance(basis, SumBasis):
        return " + ".join(basis_kind(part) for part in basis.parts)
    return next((kind for kind, made in BASES.items() if made is type(basis)), type(basis).__name__)


def _make_one(
    spec: Mapping[str, Any], where: str, sample_time: float, plant: Plant | None
) -> Basis:
    kind = spec.get("kind")
    if not isinstance(kind, str) or kind not in BASES:
        raise InputError(
            f"{where}.kind = {kind!r}: unknown basis; {suggest(str(kind), list(BASES))}"
        )
    allowed = [p for p in inspect.signature(BASES[kind]).parameters if p != "sample_time"]
    arguments: dict[str, Any] = {}
    for key, value in spec.items():
        if key == "kind":
            continue
        if key not in allowed:
            raise InputError(
                f"{where}.{key}: unknown key of basis '{kind}'; {suggest(key, allowed)}"
            )
        arguments[key] = value
    check_arguments(BASES[kind], arguments, where)
    for key in {"poles", "outside"} & set(arguments):  # complex ones are pairs in a file
        arguments[key] = [
            complex(*v) if isinstance(v, list) else complex(v) for v in arguments[key]
        ]
    if "basis" in arguments:  # a basis of bases: its own list of tables
        arguments["basis"] = make_basis(arguments["basis"], sample_time, plant)
    if "plant" in allowed:
        arguments.setdefault("plant", plant)
        if not isinstance(arguments["plant"], Plant):
            raise InputError(
                f"{where}.plant is missing: basis '{kind}' reads its effects from a plant"
            )
    try:
        return BASES[kind](**arguments, sample_time=sample_time)
    except InputError as error:
        raise InputError(f"{where} {error}") from None
    except (TypeError, ValueError) as error:
        raise InputError(f"{where}: basis '{kind}': {' '.join(str(error).split())}") from None


__all__ = [
    "BASES",
    "FIR",
    "OBF",
    "Basis",
    "Combination",
    "Compensation",
    "Derivatives",
    "Filter",
    "FreeSignal",
    "Friction",
    "SumBasis",
    "basis_kind",
    "derivative",
    "make_basis",
]
