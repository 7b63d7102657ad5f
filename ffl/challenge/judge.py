"""One answer beside its truth: what was right in it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from ffl.challenge.oracle import SEPARABLE
from ffl.challenge.outside import OUTSIDE
from ffl.challenge.physics import EFFECTS

ALARMS = ("explained", "partly_explained", "unnamed")

# Words of which one must be in the answer's text for a fault to count as said.
FAULT_WORDS = {
    "unit": ("unit", "scale", "factor", "thousand", "power of ten"),
    "sign": ("sign", "invert", "polarity"),
    "shift": ("shift", "time base", "delayed", "samples late", "samples early", "misalign"),
    "sample_time": ("sample time", "sample_time", "clock", "sampling"),
    "frozen_sensor": ("frozen", "stuck", "constant"),
    "clipped_sensor": ("clip", "saturat", "limit"),
    "gaps": ("gap", "missing sample", "samples missing", "uneven", "sample time", "irregular"),
    "wrong_controller": ("controller",),
}
SKIPPED_PARAMETERS = ("table", "kind", "centre")


@dataclass(frozen=True)
class Verdict:
    """What one case asked, what was answered, and whether it was right."""

    case: str
    kind: str
    machine: str
    concealment: str
    true: tuple[str, ...]  # effects of the truth, the main one first
    named: tuple[str, ...]  # effects of the answer, in its order
    listed: tuple[str, ...]  # named and their alternatives
    verdict: str
    confidences: tuple[tuple[float, bool], ...]  # stated, and whether the name is true
    inseparable: tuple[str, ...]  # rivals that even the oracle cannot tell from the main effect
    alarm: bool
    right: bool
    first: bool | None  # the first name is the main effect
    exact: bool | None  # the set of names is the truth's
    told: bool | None  # or differs only by what even the oracle cannot tell apart, and says so
    family: bool | None  # the same by families
    location: bool | None
    variables: bool | None  # outside the catalogue: depends_on names a right variable
    parameters: tuple[tuple[str, str, float, float | None], ...]  # effect, name, error, z
    nrmse_ratio: float | None  # after, over the oracle's: the true structure, fitted
    noise_ratio: float | None  # after, over what noise alone leaves
    seconds: float | None


def _text(answer: dict) -> str:
    parts = [answer.get("message", ""), str(answer.get("location", {}).get("where", ""))]
    return " ".join([*parts, *map(str, answer.get("advice", []))]).lower()


def _families(names: Iterable[str]) -> list[str]:
    return sorted(EFFECTS[n].family if n in EFFECTS else n for n in names)


def _parameters(truth: dict, answer: dict) -> list[tuple[str, str, float, float | None]]:
    """Relative errors (phases: rad) of the parameters of effects that were named rightly."""
    true = {e["name"]: e["parameters"] for e in truth["effects"]}
    out = []
    for effect in answer.get("effects", []):
        own = effect.get("parameters", {})
        if effect["name"] == "position_dependent_gain" and effect["name"] in true:
            own = _about(own, true[effect["name"]]["centre"])
        for name, right in true.get(effect["name"], {}).items():
            entry = own.get(name)
            if entry is None or name in SKIPPED_PARAMETERS:
                continue
            value = entry["value"] if isinstance(entry, dict) else entry
            if not isinstance(value, int | float):
                continue
            if name.startswith("phase"):
                error = math.remainder(value - right, 2 * math.pi)
                size = 1.0
            else:
                error, size = value - right, abs(right)
            spread = entry.get("std_error") if isinstance(entry, dict) else None
            z = abs(error) / spread if spread else None
            out.append((effect["name"], name, abs(error) / size if size else abs(error), z))
    return out


def _about(parameters: dict, centre: float) -> dict:
    """A gain that depends on position, told about another centre: no recording tells one centre from
    another beside a gain of its own. With d the way there and s = 1 + a d + b d^2,
    a' = (a + 2 b d)/s and b' = b/s; standard errors as of numbers that do not depend on one another."""
    entries = [
        parameters.get(key) for key in ("linear_coefficient", "quadratic_coefficient", "centre")
    ]
    told = [entry for entry in entries if isinstance(entry, dict) and "value" in entry]
    if len(told) < len(entries):
        return parameters
    a, b, at = told
    way = centre - at["value"]
    size = 1.0 + a["value"] * way + b["value"] * way**2
    slope = {**a, "value": (a["value"] + 2.0 * b["value"] * way) / size}
    bend = {**b, "value": b["value"] / size}
    if a.get("std_error") and b.get("std_error"):
        slope["std_error"] = math.hypot(a["std_error"], 2.0 * way * b["std_error"]) / abs(size)
        bend["std_error"] = b["std_error"] / abs(size)
    return {**parameters, "linear_coefficient": slope, "quadratic_coefficient": bend}


def _nrmse_ratio(truth: dict, answer: dict, left: str) -> float | None:
    """NRMSE after over what is `left` by noise alone ("after") or by the true structure fitted ("fitted",
    noise alone in the truths of before), of u where feedback makes that of y small."""
    said, floors = answer.get("validation", {}), list(truth["oracle"].values())
    if not floors or "nrmse_after" not in said:
        return None
    concealed = said.get("nrmse_before", 1.0) < 0.05 and "u_nrmse_after" in said
    key = "u_nrmse_" if concealed else "nrmse_"
    each = [f.get(key + left, f[key + "after"]) for f in floors]
    floor = math.sqrt(sum(f**2 for f in each) / len(each))
    return said[key + "after"] / floor if floor > 0 else None


def _inseparable(effect: dict) -> tuple[str, ...]:
    """Rivals that even the oracle cannot tell from an effect of the truth."""
    return tuple(n for n, energy in effect.get("rivals", {}).items() if energy < SEPARABLE)


def judge(truth: dict, record: dict | None) -> Verdict:
    """Compare one answer (None: there is none) with its truth."""
    answer = (record or {}).get("answer", {"verdict": "failed", "message": "no answer"})
    kind = truth["kind"]
    true = tuple(e["name"] for e in truth["effects"])
    effects = answer.get("effects", [])
    named = tuple(e["name"] for e in effects)
    others = [a["name"] for e in effects for a in e.get("alternatives", [])]
    verdict = answer.get("verdict", "failed")
    alarm = bool(named) or verdict in ALARMS
    main = true[0] if true else None
    close = {e["name"]: _inseparable(e) for e in truth["effects"]}
    inseparable = close[main] if main else ()
    stated = tuple(
        (float(e["confidence"]), e["name"] in true) for e in effects if "confidence" in e
    )
    first = exact = told = family = location = variables = None
    said = answer.get("location", {})
    where = {e["location"] for e in truth["effects"]}
    if kind in ("single", "several"):
        first = bool(named) and named[0] == main
        exact = set(named) == set(true)
        family = _families(set(named)) == _families(set(true))
        component = said.get("component") or (effects[0].get("location") if effects else None)
        location = component in where
        right = exact
        sure = any(c >= 0.9 and not good for c, good in stated)
        if kind == "single" and inseparable:
            right = exact or (main in (*named, *others) and not sure)
        given = all(n in named or (close[n] and n in others) for n in true)
        likely = set(true).union(*close.values())
        told = exact or (given and not sure and set(named) <= likely)
    elif kind == "outside":
        variables = bool(set(said.get("depends_on", [])) & set(truth["depends_on"]))
        location = said.get("component") in where
        right = verdict == "unnamed" and variables
    elif kind == "fault":
        words = FAULT_WORDS[truth["fault"]["name"]]
        variables = any(w in _text(answer) for w in words)
        right = verdict in ("inconclusive", "refused") and not named
    elif kind == "weak":
        right = verdict in ("nothing_missing", "inconclusive") and not named
    else:
        right = verdict == "nothing_missing" and not named
    return Verdict(
        case=truth["case"],
        kind=kind,
        machine=truth["machine"],
        concealment=truth["concealment"],
        true=true,
        named=named,
        listed=(*named, *others),
        verdict=verdict,
        confidences=stated,
        inseparable=inseparable,
        alarm=alarm,
        right=right,
        first=first,
        exact=exact,
        told=told,
        family=family,
        location=location,
        variables=variables,
        parameters=tuple(_parameters(truth, answer)),
        nrmse_ratio=_nrmse_ratio(truth, answer, "fitted"),
        noise_ratio=_nrmse_ratio(truth, answer, "after"),
        seconds=(record or {}).get("seconds"),
    )


def column(v: Verdict) -> str:
    """What the confusion matrix counts as the answer."""
    if v.true and v.true[0] in v.named:
        return v.true[0]
    return v.named[0] if v.named else v.verdict


def row(v: Verdict) -> str:
    """What the confusion matrix counts as the truth."""
    if v.kind in ("null", "parameter"):
        return "nothing"
    if v.kind in ("fault", "weak"):
        return v.kind
    return "outside" if v.true and v.true[0] in OUTSIDE else v.true[0]
