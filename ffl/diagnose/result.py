"""The diagnosis as a result: every step's own, and the contract's answer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ffl.diagnose.contest.judging import Judged
from ffl.diagnose.contest.rounds import Step
from ffl.diagnose.maps.outcome import Contest
from ffl.diagnose.maps.picture import MapPicture
from ffl.diagnose.number import Number, clean
from ffl.diagnose.proof.advise import Experiment
from ffl.diagnose.proof.prove import Proof
from ffl.diagnose.recorded.sound import Soundness
from ffl.diagnose.recorded.where import Forces, Map, Place
from ffl.diagnose.transmission.result import Transmission
from ffl.effects import EFFECTS
from ffl.systems.plant import Plant

NO_CHANCE = 0.005  # confidence


@dataclass(frozen=True)
class Finding:
    """One effect of the answer."""

    name: str
    location: str
    parameters: Mapping[str, Number]
    options: Mapping[str, Any]
    confidence: float
    p_value: float | None
    says: str
    alternatives: tuple[tuple[str, float], ...]

    @property
    def rivals(self) -> tuple[tuple[str, float], ...]:
        """The alternatives that are more than a formality: what rounds to no per cent is excluded."""
        return tuple((name, p) for name, p in self.alternatives if p >= NO_CHANCE)


@dataclass(frozen=True)
class ModelCorrection:
    """A number of the linear model that is slightly off: `relative` to nominal, or in `unit`; no
    `std_error` where it went as far as it may, which is no measurement."""

    name: str
    relative: float
    std_error: float | None
    unit: str = ""


@dataclass(frozen=True)
class Diagnosis:
    """What `diagnose` found, step by step; `answer()` is the contract's answer.json."""

    plant: Plant
    augmented: Plant
    verdict: str
    place: Place
    findings: tuple[Finding, ...]
    corrections: tuple[ModelCorrection, ...]
    proof: Proof | None
    advice: tuple[str, ...]
    soundness: Soundness
    steps: tuple[Step, ...]
    judged: Judged | None
    maps_before: tuple[Map, ...] = ()
    maps_after: tuple[Map, ...] = ()
    notes: tuple[str, ...] = ()
    nameless: Contest | None = None
    pictures: tuple[MapPicture, ...] = ()
    experiment: Experiment | None = None
    forces: Forces | None = None
    transmission: Transmission | None = None

    def answer(self) -> dict[str, Any]:
        """answer.json of `ffl diagnose` (INTERFACES.md); what could not be computed is absent."""
        place = self.place
        location: dict[str, Any] = {
            "component": place.component,
            "where": place.where,
            "depends_on": list(place.depends_on),
        }
        if place.frequency_band_hz is not None:
            location["frequency_band_hz"] = list(place.frequency_band_hz)
        if place.time_s:
            location["time_s"] = [list(pair) for pair in place.time_s]
        if place.formula:
            location["formula"] = place.formula
        if place.port:
            location["port"] = place.port
        if place.ports:
            location["ports"] = [{"port": p, "log_evidence": e} for p, e in place.ports]
        if place.linear_share is not None:
            location["linear_share"] = place.linear_share
        if place.states:
            location["states"] = [{"state": s.name, "power": s.power} for s in place.states]
        out: dict[str, Any] = {
            "schema": 1,
            "verdict": self.verdict,
            "location": {k: v for k, v in location.items() if v != ""},
            "effects": [_finding(f) for f in self.findings],
            "model_corrections": [
                clean({"name": c.name, "relative": c.relative, "std_error": c.std_error})
                | ({"unit": c.unit} if c.unit else {})
                for c in self.corrections
            ],
        }
        if self.proof is not None:
            out["validation"] = _validation(self.proof)
        out["advice"] = list(self.advice)
        if self.experiment is not None:
            out["experiment"] = _experiment(self.experiment)
        if self.notes:
            out["notes"] = list(self.notes)
        if self.transmission is not None:
            out["transmission"] = self.transmission.answer()
        return out


def _finding(f: Finding) -> dict[str, Any]:
    parameters = {name: number.answer() for name, number in f.parameters.items()}
    return clean(
        {
            "name": f.name,
            "location": f.location,
            "parameters": parameters,
            "options": dict(f.options),
            "confidence": round(f.confidence, 4),
            "p_value": f.p_value,
            "says": f.says,
            "alternatives": [{"name": n, "confidence": round(p, 4)} for n, p in f.alternatives],
        }
    )


def _experiment(e: Experiment) -> dict[str, Any]:
    return clean(
        {
            "file": "experiment.csv",
            "what": e.text,
            "between": [name for name in e.rivals if name],
            "separation": e.separation,
            "tried": [{"what": text, "separation": value} for text, value in e.tried],
        }
    )


def _validation(proof: Proof) -> dict[str, Any]:
    return clean(
        {
            "recordings": list(proof.recordings),
            "nrmse_before": proof.nrmse_before,
            "nrmse_after": proof.nrmse_after,
            "noise_floor": proof.noise_floor,
            "u_nrmse_before": proof.u_nrmse_before,
            "u_nrmse_after": proof.u_nrmse_after,
            "u_noise_floor": proof.u_noise_floor,
            "change_interval_95": list(proof.interval),
            "nrmse_with_map": proof.nrmse_with_map,
            "u_nrmse_with_map": proof.u_nrmse_with_map,
        }
        | ({"noise_untold": True} if proof.untold else {})
    )


def component_of(name: str) -> str:
    return EFFECTS[name].component
