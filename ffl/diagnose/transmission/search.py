"""Which terms the difference of two encoders has: forward selection, backward elimination, rivals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ffl.diagnose.noise.coloured import whitened
from ffl.diagnose.transmission.terms import MOST, Fit, Scene, Term, columns, driving

PRICE = 9.0  # log-likelihood that a term must bring: reports/real_recordings.md says on what nulls
SHARE = 3.0  # the same, of where friction acts once there is a spring
NUMBER = 1.0  # for every number beyond the first
LEAST = 0.02  # of all that was brought by then: less is what those terms themselves are wrong by
HELD = 0.25  # of the price, that it must bring to blocks foretold by the others
SURE = 3.0  # standard errors
NEAR = 3.0  # log-likelihood within which two explanations are not told apart
PERIODS = 400  # most that are looked at
REACHES = 8  # of a play
SHARES = (0.25, 0.5, 0.75)  # of the friction behind the spring, that a play is tried with
SMALL = 3.0  # times the encoders' noise: least reach of a play that can be told from it


@dataclass(frozen=True)
class Rival:
    """Terms that enter together and what they must bring."""

    terms: tuple[Term, ...]
    price: float


@dataclass(frozen=True)
class Found:
    """What stands, what every term brings there (fitted, held out), and rivals that do as well."""

    scene: Scene
    fit: Fit
    null: Fit
    gains: tuple[tuple[float, float], ...]
    alternatives: tuple[tuple[str, ...], ...]
    others: tuple[Rival, ...]


def search(scene: Scene) -> Found | None:
    """Terms one after another while the best brings its price, fitted and held out."""
    standing = scene.fit(())
    if standing is None:
        return None
    stood: set[tuple[str, ...]] = set()
    while True:
        scene = scene.winding(standing).beside(standing.terms)
        standing = _physical(scene, scene.fit(standing.terms) or standing)
        null = scene.fit(()) or standing
        least = LEAST * (standing.regression.log_likelihood - null.regression.log_likelihood)
        best: tuple[float, Fit] | None = None
        for rival in rivals(scene, standing):
            fit = joined(scene, standing, rival)
            if fit is None or not fit.physical or not _sure(scene, fit, rival):
                continue
            gain = fit.regression.log_likelihood - standing.regression.log_likelihood
            held = fit.regression.held_out - standing.regression.held_out
            if gain < max(rival.price, least) or held < HELD * rival.price:
                continue
            if best is None or gain - rival.price > best[0]:
                best = gain - rival.price, fit
        names = tuple(sorted(str(t) for t in standing.terms))
        if best is None or names in stood:  # what goes and comes back says no more
            break
        stood.add(names)
        standing = _retuned(scene, _pruned(scene, best[1]))
    others = rivals(scene, standing)
    gains, alternatives = [], []
    for term in standing.terms:
        less = _without(scene, standing, term)
        base = less.regression if less else null.regression
        whole = standing.regression
        gains.append((whole.log_likelihood - base.log_likelihood, whole.held_out - base.held_out))
        alternatives.append(_as_good(scene, standing, term, others))
    return Found(scene, standing, null, tuple(gains), tuple(alternatives), others)


def joined(scene: Scene, standing: Fit, rival: Rival) -> Fit | None:
    return scene.fit((*standing.terms, *rival.terms))


def rivals(scene: Scene, standing: Fit) -> tuple[Rival, ...]:
    """What may be added: every term that is not there, a ripple at the best period, a play at the best
    reach."""
    known = scene.known
    has = standing.has
    out = []
    if not has("delay"):
        out.append(Rival((Term("delay"),), PRICE))
    if not has("scale"):
        out.append(Rival((Term("scale"),), PRICE))
    driven = has("torsion") or has("command") or has("inertia")
    told = known.load_mass is not None or known.has_load
    if known.moved and not driven:
        if told:
            out.append(Rival((Term("torsion", "load"),), PRICE))
        else:
            out.append(Rival((Term("inertia"),), PRICE))
        if told and known.has_command and known.load_mass is not None:
            both = (Term("torsion", "load"), Term("friction"))
            out.append(Rival((Term("torsion", "command"),), PRICE))
            out.append(Rival(both, PRICE + SHARE))
        if not told and known.has_command:
            out.append(Rival((Term("command"),), PRICE + NUMBER))
    if has("torsion") and known.load_mass is not None:
        if known.has_command and not has("friction") and Term("torsion", "load") in standing.terms:
            out.append(Rival((Term("friction"),), SHARE))
        if not has("damping"):
            out.append(Rival((Term("damping"),), PRICE))
    if not has("play"):
        drivers = ["travel"] + (["load"] if told and known.moved else [])
        drivers += ["command"] if known.has_command and known.load_mass is not None else []
        plays = [_best_play(scene, standing, by) for by in drivers]
        if len(drivers) == 3:
            plays.append(_best_play(scene, standing, "torque", SHARES))
        out += [p for p in plays if p is not None]
    if sum(t.name == "ripple" for t in standing.terms) < MOST:
        ripple = _best_ripple(scene, standing)
        if ripple is not None:
            out.append(ripple)
    return tuple(out)


def _sure(scene: Scene, fit: Fit, rival: Rival) -> bool:
    """Numbers stand clear of zero; a ripple's amplitude is judged by its likelihood, friction's share
    by whether there is a spring."""
    for term in rival.terms:
        if term.name in ("ripple", "friction"):
            continue
        at = fit.place(term).start
        value, error = fit.regression.values[at], fit.regression.std_errors[at]
        if term.name == "delay":
            value = value + scene.shift
        if abs(value) < SURE * error:
            return False
    return True


def _physical(scene: Scene, fit: Fit) -> Fit:
    """With numbers of the physics again: all friction on one side of the spring where the share says more
    than all of it, else without the last terms."""
    if not fit.believable:
        all_behind = fit.value("friction")[0] > 0.0
        spring = Term("torsion", "command" if all_behind else "load")
        rest = [t for t in fit.terms if t.name not in ("torsion", "friction", "damping")]
        fit = scene.fit((spring, *rest)) or fit
    terms = fit.terms
    while not fit.physical and terms:
        terms = terms[:-1]
        fit = scene.fit(terms) or fit
    return fit


def _retuned(scene: Scene, fit: Fit) -> Fit:
    """With the play driven by the torque of the spring as it stands now."""
    play = next((t for t in fit.terms if t.name == "play" and t.by != "travel"), None)
    rest = None if play is None else _without(scene, fit, play)
    if rest is None or not fit.has("friction"):
        return fit
    share = fit.value("friction")[0] / fit.value("torsion")[0]
    rival = _best_play(scene, rest, "torque", (share,))
    other = None if rival is None else joined(scene, rest, rival)
    if other is None or not other.physical:
        return fit
    ahead = other.regression.log_likelihood - fit.regression.log_likelihood
    return other if ahead > 0.0 else fit


def _pruned(scene: Scene, fit: Fit) -> Fit:
    """Without terms that, now others stand, bring less than they cost."""
    while True:
        losses = []
        for term in fit.terms:
            less = _without(scene, fit, term)
            if less is None or not less.physical:
                continue
            loss = fit.regression.log_likelihood - less.regression.log_likelihood
            losses.append((loss - (SHARE if term.name == "friction" else PRICE), less))
        weakest = min(losses, key=lambda pair: pair[0], default=None)
        if weakest is None or weakest[0] >= 0.0:
            return fit
        fit = weakest[1]


def _without(scene: Scene, fit: Fit, term: Term) -> Fit | None:
    """The rest of the terms; friction and damping go with their torsion."""
    gone = {"torsion": ("torsion", "friction", "damping")}.get(term.name)
    kept = [t for t in fit.terms if t != term and (gone is None or t.name not in gone)]
    return scene.fit(kept)


def _as_good(scene: Scene, fit: Fit, term: Term, others: Sequence[Rival]) -> tuple[str, ...]:
    """Names of what explains as well in the place of `term`."""
    rest = _without(scene, fit, term)
    if rest is None or term.name == "delay":
        return ()
    names = []
    for rival in (*others, *rivals(scene, rest)):
        if term in rival.terms or any(t in rest.terms for t in rival.terms):
            continue
        if any(t.name == term.name and t.by == term.by for t in rival.terms):
            continue
        other = scene.fit((*rest.terms, *rival.terms))
        if other is None or not other.physical:
            continue
        ahead = fit.regression.log_likelihood - other.regression.log_likelihood
        extra = len(other.regression.values) - len(fit.regression.values)
        name = str(rival.terms[0])
        if ahead + NUMBER * extra < NEAR and name not in names and name != "delay":
            names.append(name)
    return tuple(names)


def _best_ripple(scene: Scene, standing: Fit) -> Rival | None:
    """The period whose sine and cosine bring most beside what stands, in its noise."""
    pairs = scene.pairs(standing.terms)
    whole = np.concatenate([p.measured for p in pairs])
    travel = float(np.ptp(whole))
    speed = max(float(np.abs(p.velocity).max()) for p in pairs)
    least = max(3.0 * pairs[0].width * speed, 2e-3 * travel)
    if travel <= 0.0 or least >= 2.0 * travel:
        return None
    count = int(min(PERIODS, max(8, round(4.0 * travel / least))))
    inverse = np.linspace(1.0 / (2.0 * travel), 1.0 / least, count)
    taken = [t.period for t in standing.terms if t.name == "ripple"]
    gain = _Beside(scene, standing)
    gains = np.array([gain(Term("ripple", period=1.0 / f)) for f in inverse])
    for period in taken:
        gains[np.abs(inverse - 1.0 / period) < 0.5 / travel] = 0.0
    at = int(np.argmax(gains))
    if gains[at] <= 0.0:
        return None
    step = inverse[1] - inverse[0]
    fine = np.linspace(inverse[at] - step, inverse[at] + step, 9)
    fine = fine[fine >= inverse[0]]
    best = max(fine, key=lambda f: gain(Term("ripple", period=1.0 / f)))
    price = PRICE + NUMBER + float(np.log(count / 2.0))
    return Rival((Term("ripple", period=float(1.0 / best)),), price)


def _best_play(
    scene: Scene, standing: Fit, by: str, shares: Sequence[float] = (0.0,)
) -> Rival | None:
    """The reach and first side of a play that bring most beside what stands."""
    pairs = scene.pairs(standing.terms)
    first = Term("play", by, share=shares[0])
    span = min(float(np.ptp(driving(first, p, scene.known))) for p in pairs)
    least, most = 1e-3 * span, 0.25 * span
    if by == "travel":
        least = SMALL * standing.regression.spread
        most = min(most, 2.0 * max(float(np.ptp(p.difference)) for p in pairs))
    if not 0.0 < least < most:
        return None
    tried = [
        Term("play", by, reach=float(reach), side=side, share=share)
        for share in shares
        for reach in np.geomspace(least, most, REACHES)
        for side in (-1.0, 0.0, 1.0)
    ]
    gain = _Beside(scene, standing)
    gains = [gain(term) for term in tried]
    at = int(np.argmax(gains))
    return Rival((tried[at],), PRICE + float(np.log(len(tried)))) if gains[at] > 0.0 else None


class _Beside:
    """What a further term brings beside those that stand, in the noise as it is: log-likelihood."""

    def __init__(self, scene: Scene, standing: Fit) -> None:
        self.pairs, self.known, self.phi = scene.pairs(standing.terms), scene.known, scene.phi
        old = np.concatenate([whitened(t, self.phi) for t in scene.tables(standing.terms)])
        target = np.concatenate([whitened(y, self.phi) for y in scene.targets(standing.terms)])
        self.q, _ = np.linalg.qr(old / np.maximum(np.sqrt((old**2).sum(axis=0)), 1e-300))
        self.rest = target - self.q @ (self.q.T @ target)

    def __call__(self, term: Term) -> float:
        new = [whitened(columns(term, p, self.known), self.phi) for p in self.pairs]
        table = np.concatenate(new)
        own = table - self.q @ (self.q.T @ table)
        size = np.sqrt((table**2).sum(axis=0))
        if np.any(np.sqrt((own**2).sum(axis=0)) <= 1e-6 * size):
            return 0.0
        basis, _ = np.linalg.qr(own)
        before = float(self.rest @ self.rest)
        after = before - float(np.sum((basis.T @ self.rest) ** 2))
        return 0.5 * len(self.rest) * float(np.log(before / max(after, 1e-300)))
