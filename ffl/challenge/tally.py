"""Counting over a blind run: shares with intervals, confusion, calibration, errors."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass

import numpy as np
import scipy.stats

from ffl.challenge.judge import Verdict, column, row
from ffl.challenge.physics import EFFECTS

BINS = (0.0, 0.5, 0.7, 0.85, 0.95, 1.0)


@dataclass(frozen=True)
class Share:
    """k of n with its 95 % Clopper-Pearson interval."""

    k: int
    n: int

    @classmethod
    def of(cls, flags: Iterable[bool | None]) -> Share:
        counted = [bool(f) for f in flags if f is not None]
        return cls(sum(counted), len(counted))

    @property
    def value(self) -> float:
        return self.k / self.n if self.n else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        if self.n == 0:
            return 0.0, 1.0
        beta = scipy.stats.beta
        low = 0.0 if self.k == 0 else float(beta.ppf(0.025, self.k, self.n - self.k + 1))
        high = 1.0 if self.k == self.n else float(beta.ppf(0.975, self.k + 1, self.n - self.k))
        return low, high

    def __str__(self) -> str:
        if self.n == 0:
            return "none"
        low, high = self.interval
        return f"{100 * self.value:.1f} % ({self.k}/{self.n}; {100 * low:.1f} to {100 * high:.1f})"


@dataclass(frozen=True)
class Score:
    """Figures of one blind run; `rows` holds every case."""

    root: str
    seed: int
    fraction: float
    rows: tuple[Verdict, ...]
    shares: dict[str, Share]
    per_effect: dict[str, tuple[Share, Share]]  # recall, precision
    calibration: tuple[tuple[float, float, float, int, float], ...]  # from, to, mean, n, right
    parameter_errors: dict[str, tuple[int, float, float]]  # n, median, 90 % quantile (relative)
    within_two_sigma: Share
    f1_micro: float
    f1_macro: float
    nrmse_ratio: tuple[float, float, float]  # median, 85 % quantile, share within 1.2
    noise_ratio: tuple[float, float, float]  # the same over what noise alone leaves
    seconds: tuple[float, float, float]  # median, mean, max
    confusion_rows: tuple[str, ...]
    confusion_columns: tuple[str, ...]
    confusion: np.ndarray


def _f1(true: Sequence[set], named: Sequence[set], effect: str | None = None) -> float:
    """F1 over label decisions: of one effect, or pooled over all."""
    hit = extra = missed = 0
    for t, n in zip(true, named, strict=True):
        if effect is not None:
            t, n = t & {effect}, n & {effect}
        hit, extra, missed = hit + len(t & n), extra + len(n - t), missed + len(t - n)
    return 2 * hit / (2 * hit + extra + missed) if hit + extra + missed else float("nan")


def _confusion(rows: Sequence[Verdict]) -> tuple[tuple[str, ...], tuple[str, ...], np.ndarray]:
    true, said = [row(v) for v in rows], [column(v) for v in rows]
    order = [*EFFECTS, "outside", "nothing", "weak", "fault"]
    left = tuple(n for n in order if n in true)
    verdicts = sorted(set(said) - set(EFFECTS))
    right = tuple([n for n in EFFECTS if n in said or n in true] + verdicts)
    matrix = np.zeros((len(left), len(right)), int)
    for a, b in zip(true, said, strict=True):
        matrix[left.index(a), right.index(b)] += 1
    return left, right, matrix


def _near(ratios: Iterable[float | None]) -> Share:
    """Of those with an oracle."""
    return Share.of(ratio <= 1.2 for ratio in ratios if ratio is not None)


def tally(rows: Sequence[Verdict], root: str, seed: int, fraction: float) -> Score:
    """All figures from the judged cases."""
    kinds = {
        k: [v for v in rows if v.kind == k] for k in ("single", "several", "null", "parameter")
    }
    outside, weak, fault = ([v for v in rows if v.kind == k] for k in ("outside", "weak", "fault"))
    single, several = kinds["single"], kinds["several"]
    effects = single + several
    clear = [v for v in single if not v.inseparable]
    plain = [v for v in clear if v.concealment != "masked"]
    shares = {
        "answered": Share.of(v.verdict != "failed" for v in rows),
        "false alarms, nothing missing": Share.of(v.alarm for v in kinds["null"]),
        "false alarms, parameters wrong": Share.of(v.alarm for v in kinds["parameter"]),
        "nothing missing, said so": Share.of(v.right for v in kinds["null"] + kinds["parameter"]),
        "refused though sound": Share.of(v.verdict == "refused" for v in rows if v.kind != "fault"),
        "named first, separable": Share.of(v.first for v in plain),
        "right, single": Share.of(v.right for v in single),
        "right, inseparable": Share.of(v.right for v in single if v.inseparable),
        "exact set, single": Share.of(v.exact for v in single),
        "exact set, several": Share.of(v.exact for v in several),
        "exact set, two effects": Share.of(v.exact for v in several if len(v.true) == 2),
        "exact set, three effects": Share.of(v.exact for v in several if len(v.true) > 2),
        "several: exact, or the inseparable listed": Share.of(v.told for v in several),
        "main effect named, several": Share.of(v.true[0] in v.named for v in several),
        **{
            f"held-out error within 1.2 of the oracle's, {k}": _near(
                v.nrmse_ratio for v in kinds[k]
            )
            for k in ("single", "several")
        },
        **{
            f"held-out error within 1.2 of the noise, {k}": _near(v.noise_ratio for v in kinds[k])
            for k in ("single", "several")
        },
        "family, all": Share.of(v.family for v in effects),
        "location": Share.of(v.location for v in effects),
        "outside: unnamed, right variables": Share.of(v.right for v in outside),
        "outside: the same, separable": Share.of(v.right for v in outside if not v.inseparable),
        "outside: unnamed": Share.of(v.verdict == "unnamed" for v in outside),
        "outside: explained by a wrong name": Share.of(v.verdict == "explained" for v in outside),
        "outside: location": Share.of(v.location for v in outside),
        "weak: nothing claimed": Share.of(v.right for v in weak),
        "fault: not called physics": Share.of(v.right for v in fault),
        "fault: said": Share.of(v.variables for v in fault),
        "truth among the names listed": Share.of(n in v.listed for v in effects for n in v.true),
    }
    for c in sorted({v.concealment for v in effects}):
        chosen = [v for v in effects if v.concealment == c]
        shares[f"exact set, {c}"] = Share.of(v.exact for v in chosen)
        shares[f"family, {c}"] = Share.of(v.family for v in chosen)
    stated = [pair for v in rows for pair in v.confidences]
    calibration = []
    for low, high in itertools.pairwise(BINS):
        part = [p for p in stated if low <= p[0] < high or (high == 1.0 and p[0] >= 1.0)]
        if part:
            mean, hit = np.mean([p[0] for p in part]), np.mean([p[1] for p in part])
            calibration.append((low, high, float(mean), len(part), float(hit)))
    true, named = [set(v.true) for v in effects], [set(v.named) for v in effects]
    per_effect = {
        e: (
            Share.of(e in v.named for v in effects if e in v.true),
            Share.of(e in v.true for v in rows if e in v.named and v.kind != "weak"),
        )
        for e in EFFECTS
    }
    macro = [_f1(true, named, e) for e in EFFECTS]
    macro = [f for f in macro if not np.isnan(f)]
    errors: dict[str, list[float]] = {}
    scores = []
    for v in rows:
        for effect, name, error, z in v.parameters:
            errors.setdefault(f"{effect}.{name}", []).append(error)
            scores += [] if z is None else [z < 2]
    seconds = [v.seconds for v in rows if v.seconds is not None]
    left, right, matrix = _confusion(rows)

    def figures(values, *statistics):
        return tuple(float(s(values)) if values else float("nan") for s in statistics)

    def over(ratios):
        return figures(
            [x for x in ratios if x is not None],
            np.median,
            lambda x: np.quantile(x, 0.85),
            lambda x: np.mean(np.array(x) <= 1.2),
        )

    return Score(
        root,
        seed,
        fraction,
        tuple(rows),
        shares,
        per_effect,
        tuple(calibration),
        {
            k: (len(x), float(np.median(x)), float(np.quantile(x, 0.9)))
            for k, x in sorted(errors.items())
        },
        Share.of(scores),
        _f1(true, named),
        float(np.mean(macro)) if macro else float("nan"),
        over(v.nrmse_ratio for v in effects),
        over(v.noise_ratio for v in effects),
        figures(seconds, np.median, np.mean, np.max),
        left,
        right,
        matrix,
    )


def as_json(score: Score) -> dict:
    """The score as plain numbers; what could not be computed is absent."""

    def absent(value):
        return value is None or (isinstance(value, float) and np.isnan(value))

    def clean(value):
        if isinstance(value, Share):
            low, high = value.interval
            return {"k": value.k, "n": value.n, "low": low, "high": high}
        if isinstance(value, np.ndarray):
            return value.tolist()
        if isinstance(value, Verdict):
            return clean(asdict(value))
        if isinstance(value, dict):
            return {k: clean(v) for k, v in value.items() if not absent(v)}
        if isinstance(value, tuple | list):
            return [clean(v) for v in value if not absent(v)]
        return value

    names = Score.__dataclass_fields__
    return {"schema": 1, **clean({name: getattr(score, name) for name in names})}
