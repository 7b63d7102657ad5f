"""What two encoders tell of a transmission, as a result: numbers, sentences, what stays open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffl.diagnose.number import Number
from ffl.diagnose.transmission.search import NEAR, NUMBER, Found
from ffl.diagnose.transmission.terms import Fit, Scene, Term, columns, driving
from ffl.effects.modal import force_unit
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array

ALIKE = 0.9  # correlation of two values beyond which they are said to go together
TWO = 1.96  # standard errors of a 95 % interval
BEND = 0.75  # of the travel: a longer period is a bend, not a ripple


@dataclass(frozen=True)
class Part:
    """One term of what the encoders differ by."""

    name: str
    parameters: dict[str, Number]
    says: str
    gain: float
    held_out_gain: float
    alternatives: tuple[str, ...] = ()


@dataclass(frozen=True)
class Drawn:
    """For the picture, of one recording: (n,) each, in output units and the force's."""

    source: str
    t: Array
    difference: Array
    explained: Array
    torque: Array | None
    by: str
    rest: Array
    torsion: Array | None


@dataclass(frozen=True)
class Transmission:
    """What the second encoder tells. `explained`: share of the difference's power foretold in blocks
    (or recordings) that were left out, by everything and by the delay alone; RMS in output units."""

    unit: str
    force: str
    parts: tuple[Part, ...]
    stiffness: tuple[float, float | None] | None
    undecided: tuple[str, ...]
    difference: float
    left: float
    explained: float
    explained_by_delay: float
    judged: str
    samples: int
    cut: float
    drawn: tuple[Drawn, ...]
    notes: tuple[str, ...] = ()

    def answer(self) -> dict[str, object]:
        """The key `transmission` of answer.json."""
        out: dict[str, object] = {
            "terms": [
                {
                    "name": p.name,
                    "parameters": {k: n.answer() for k, n in p.parameters.items()},
                    "says": p.says,
                    "gain": p.gain,
                    "held_out_gain": p.held_out_gain,
                    "alternatives": list(p.alternatives),
                }
                for p in self.parts
            ],
            "cannot_tell": list(self.undecided),
            "difference_rms": {"value": self.difference, "unit": self.unit},
            "left_rms": {"value": self.left, "unit": self.unit},
            "explained_held_out": self.explained,
            "explained_by_delay": self.explained_by_delay,
            "judged_by": self.judged,
            "below_hz": self.cut,
        }
        if self.stiffness is not None:
            low, high = self.stiffness
            interval = {"at_least": low} | ({} if high is None else {"at_most": high})
            out["stiffness_95"] = interval | {"unit": f"{self.force}/{self.unit}"}
        if self.notes:
            out["notes"] = list(self.notes)
        return out


def told(
    model: Plant,
    scene: Scene,
    found: Found,
    judging: Scene | None,
    cut: float,
    notes: list[str],
) -> Transmission:
    unit = model.output_unit or "output"
    force = force_unit(model)
    fit = found.fit
    parts = tuple(
        _part(scene, fit, term, unit, force, gain, others)
        for term, gain, others in zip(fit.terms, found.gains, found.alternatives, strict=True)
        if term.name not in ("friction", "damping")
    )
    region, undecided = _stiffness(scene, found, unit, force)
    undecided += _either(fit, found.alternatives) + _together(fit)
    delay = scene.fit([t for t in fit.terms if t.name == "delay"]) or found.null
    whole, alone, judged = _shares(scene, fit, delay, judging)
    pairs = scene.pairs(fit.terms)
    before = np.concatenate([p.difference - p.difference.mean() for p in pairs])
    drawn = tuple(_drawn(scene, fit, i) for i in range(len(pairs)))
    left = np.concatenate([d.rest for d in drawn])
    raw = np.concatenate([p.difference - p.difference.mean() for p in scene.plain])
    return Transmission(
        unit, force, parts, region, tuple(undecided), _rms(raw), _rms(left), whole, alone, judged,
        len(before), cut, drawn, tuple(notes),
    )  # fmt: skip


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _shares(scene: Scene, fit: Fit, delay: Fit, judging: Scene | None) -> tuple[float, float, str]:
    """Share of the power of the difference that is foretold where nothing was fitted."""
    if judging is None:
        raw = float(sum(np.sum((p.difference - p.difference.mean()) ** 2) for p in scene.plain))
        parts = [float(np.sum(f.regression.left_out**2)) for f in (fit, delay)]
        return 1 - parts[0] / raw, 1 - parts[1] / raw, "tenths of the recordings, left out in turn"
    raw = float(sum(np.sum((p.difference - p.difference.mean()) ** 2) for p in judging.plain))
    shares = []
    for f in (fit, delay):
        values = f.regression.values[f.offsets :]
        power = 0.0
        targets = replace(judging, wound=scene.wound).targets(f.terms)
        for p, left in zip(judging.pairs(f.terms), targets, strict=True):
            if len(values):
                left = (
                    left - np.column_stack([columns(t, p, judging.known) for t in f.terms]) @ values
                )
            power += float(np.sum((left - left.mean()) ** 2))
        shares.append(1 - power / raw)
    return shares[0], shares[1], ", ".join(p.source for p in judging.plain)


def _drawn(scene: Scene, fit: Fit, index: int) -> Drawn:
    p = scene.pairs(fit.terms)[index]
    plain = scene.plain[index]
    values = fit.regression.values
    table = scene.tables(fit.terms)[index]
    rest = scene.targets(fit.terms)[index] - table @ values
    rest = rest - rest.mean()
    shown = plain.difference - plain.difference.mean()
    known = scene.known
    spring = [t for t in fit.terms if t.name in ("torsion", "friction", "command", "inertia")]
    torsion = None
    if spring:
        pulls = (columns(t, p, known) @ values[fit.place(t)] for t in spring)
        torsion = sum(pulls, np.zeros(len(p.t)))
    told = known.load_mass is not None or known.has_load
    by = "load" if told else "command"
    for term in spring:
        by = "command" if term.by == "command" or term.name == "command" else by
    tau = driving(Term("torsion", by), p, known) if told or known.has_command else None
    side = {"load": "the load's side", "command": "the command"}[by]
    return Drawn(p.source, p.t, shown, shown - rest, tau, side, rest, torsion)


def _part(
    scene: Scene,
    fit: Fit,
    term: Term,
    unit: str,
    force: str,
    gain: tuple[float, float],
    others: tuple[str, ...],
) -> Part:
    at = fit.place(term)
    values = fit.regression.values[at]
    errors = fit.regression.std_errors[at]
    value, error = float(values[0]), float(errors[0])
    figures: dict[str, Number] = {}
    if term.name == "delay":
        total = scene.shift + value
        figures["delay"] = Number(total, "s", error)
        which = "later" if total > 0 else "earlier"
        says = (
            f"the load's encoder is read {abs(total) * 1e3:.4g} ms {which} than the motor's (or its "
            "signal is held up so long)"
        )
        if Term("torsion", "load") in fit.terms and not fit.has("friction"):
            c = 1.0 / fit.value("torsion")[0]
            says += (
                f"; viscous friction behind the spring would take away {1e3 / c:.3g} ms of it for every "
                f"{force} s/{unit}, and cannot be told from it"
            )
    elif term.name == "scale":
        figures["relative"] = Number(value, "1", error)
        says = f"the load's encoder, or the ratio, is off by {1e6 * value:.4g} ppm"
    elif term.name in ("torsion", "inertia", "command"):
        figures, says = _spring(scene, fit, term, unit, force)
    elif term.name == "play":
        figures["gap"] = Number(2.0 * value, unit, 2.0 * error)
        by = (
            "the motion turns back"
            if term.by == "travel"
            else "the transmitted torque changes sign"
        )
        says = f"lost motion of {2 * value:.4g} {unit} between motor and load, taken up where {by}"
        if term.by == "travel":
            says += "; play, or a spring wound up by dry friction behind it, look alike here"
    else:
        figures["amplitude"] = Number(float(np.hypot(*values)), unit, float(np.max(errors)))
        figures["period"] = Number(term.period, unit)
        figures["phase"] = Number(float(np.arctan2(values[1], values[0])), "rad")
        travel = max(float(np.ptp(p.measured)) for p in scene.plain)
        size = f"{figures['amplitude'].value:.3g} {unit}"
        if term.period > BEND * travel:
            says = f"a bend over the stroke, part of a wave of {size}: eccentricity, or a scale"
        else:
            says = f"a ripple of {size} every {term.period:.4g} {unit}: gear mesh, eccentricity or a scale"
    return Part(term.name, figures, says, gain[0], gain[1], others)


def _spring(
    scene: Scene, fit: Fit, term: Term, unit: str, force: str
) -> tuple[dict[str, Number], str]:
    """The spring's numbers: stiffness, damping, antiresonance, where friction sits."""
    known = scene.known
    value, error = fit.value(term.name)
    figures: dict[str, Number] = {}
    if term.name == "inertia":
        frequency = 1.0 / (2 * np.pi * float(np.sqrt(value)))
        figures["antiresonance"] = Number(frequency, "Hz", 0.5 * frequency * error / value)
        return figures, (
            f"the transmission gives way with the load's acceleration: antiresonance at {frequency:.4g} "
            "Hz; state [physics] load_mass, and the stiffness follows"
        )
    c = 1.0 / value
    figures["stiffness"] = Number(c, f"{force}/{unit}", c * error / value)
    says = f"a spring of {c:.4g} {force}/{unit} between motor and load"
    if term.name == "command":
        says += ", wound up by the command less the motor's inertia; friction at the motor counts into it"
    elif term.by == "command":
        says += ", wound up by what the motor gives: friction acts behind it"
    else:
        says += ", wound up by what the load asks for: friction acts at the motor"
    if fit.has("friction"):
        share, doubt = fit.value("friction")
        figures["friction_behind"] = Number(share / value, "1", doubt / value)
        says += f", but for {share / value:.2g} of it, which acts behind the spring"
    if fit.has("damping"):
        damping, doubt = fit.value("damping")
        figures["damping"] = Number(-damping / value**2, f"{force} s/{unit}", doubt / value**2)
    if known.load_mass is not None and term.name == "torsion":
        frequency = float(np.sqrt(c / known.load_mass)) / (2 * np.pi)
        figures["antiresonance"] = Number(frequency, "Hz", 0.5 * frequency * error / value)
    return figures, says


def _stiffness(
    scene: Scene, found: Found, unit: str, force: str
) -> tuple[tuple[float, float | None] | None, list[str]]:
    """95 % region of the stiffness over everything that explains as well, and what that leaves open."""
    known = scene.known
    if not known.moved or (known.load_mass is None and not known.has_load):
        return None, []
    fit = found.fit
    kept = tuple(t for t in fit.terms if t.name not in ("torsion", "friction", "damping"))
    variants = [kept]
    variants += [(*kept, *r.terms) for r in found.others if not _of_spring(r.terms)]
    for term in kept:
        if term.name in ("scale", "ripple", "play"):
            variants.append(tuple(t for t in kept if t != term))
    load = Term("torsion", "load")
    spring: list[tuple[Term, ...]] = [(load,)]
    if known.has_command and known.load_mass is not None:
        spring += [(Term("torsion", "command"),), (load, Term("friction"))]
    fits = [scene.fit((*v, *s)) for v in variants for s in spring]
    tried = [f for f in (*fits, fit) if f is not None and f.has("torsion")]
    if not tried:
        return None, []

    def score(f: Fit) -> float:
        return f.regression.log_likelihood - NUMBER * len(f.regression.values)

    tried = [f for f in tried if f.believable]
    if not tried:
        return None, []
    best = max(score(f) for f in tried)
    near = [f.value("torsion") for f in tried if score(f) > best - NEAR]
    low = min(v - TWO * e for v, e in near)
    high = max(v + TWO * e for v, e in near)
    if high <= 0.0:
        return None, [
            f"torsion: what is left goes against the torque (compliance at most {high:.3g} "
            f"{unit}/({force})): something that moves alike in this recording covers it"
        ]
    region = (1.0 / high, 1.0 / low if low > 0.0 else None)
    if fit.has("torsion") and low > 0.0:
        return region, []
    says = (
        f"torsion: the recording does not tell the spring from what else explains the difference; "
        f"stiffness at least {region[0]:.3g} {force}/{unit} (95 %)"
    )
    return region, [says]


def _either(fit: Fit, alternatives: Sequence[tuple[str, ...]]) -> list[str]:
    """Terms in whose place another does as well."""
    out = []
    for term, others in zip(fit.terms, alternatives, strict=True):
        foreign = [name for name in others if name.split(" by ")[0] != term.name]
        if foreign and term.name not in ("friction", "damping"):
            out.append(
                f"{term.name} or {', '.join(foreign)}: either explains the difference in this recording; "
                "moves of other lengths and accelerations would tell"
            )
    return out


def _of_spring(terms: Sequence[Term]) -> bool:
    return any(t.name in ("torsion", "friction", "damping", "command", "inertia") for t in terms)


def _together(fit: Fit) -> list[str]:
    """Pairs of terms that go alike in these recordings."""
    cov = fit.regression.covariance
    size = np.sqrt(np.diag(cov))
    out = []
    for i, one in enumerate(fit.terms):
        for other in fit.terms[i + 1 :]:
            a, b = fit.place(one), fit.place(other)
            table = np.abs(cov[a, b] / np.outer(size[a], size[b]))
            if float(table.max()) > ALIKE:
                out.append(
                    f"{one.name} and {other.name} go alike in this recording (correlation "
                    f"{float(table.max()):.2f}): what one takes the other gives"
                )
    return out
