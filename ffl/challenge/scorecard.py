"""The score of a blind run in words: bars, tables, a markdown section for reports/challenge.md."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from ffl.challenge.tally import Score


@dataclass(frozen=True)
class Bar:
    """One requirement on a fresh seed; `met` is None where no case speaks to it."""

    what: str
    wanted: str
    measured: str
    met: bool | None


def bars(score: Score) -> list[Bar]:
    """The bars of the blind challenge."""
    found = []

    def share(what: str, key: str, wanted: float, most: bool = False) -> None:
        s = score.shares[key]
        met = None if s.n == 0 else (s.value <= wanted if most else s.value >= wanted)
        text = f"at {'most' if most else 'least'} {100 * wanted:g} %"
        found.append(Bar(what, text, str(s), met))

    share("false alarms, nothing missing", "false alarms, nothing missing", 0.01, True)
    share("false alarms, parameters wrong", "false alarms, parameters wrong", 0.01, True)
    share("single effects named first where an oracle can separate", "named first, separable", 0.95)
    share("single effects right, all concealments", "right, single", 0.85)
    share("several effects, exact set", "exact set, several", 0.80)
    share("location", "location", 0.95)
    share(
        "outside the catalogue: unnamed, a right variable", "outside: unnamed, right variables", 0.8
    )
    nine = [c for c in score.calibration if c[0] == 0.85]
    if nine:
        _, _, mean, n, right = nine[0]
        text = f"{100 * right:.0f} % of {n} (stated {100 * mean:.0f} %)"
        found.append(
            Bar("stated confidences of 85 to 95 %", "right 85 to 95 %", text, 0.85 <= right <= 0.95)
        )
    ratio = score.nrmse_ratio[0]
    met = None if math.isnan(ratio) else ratio <= 1.1
    found.append(Bar("median NRMSE after over the oracle's", "at most 1.1", f"{ratio:.3f}", met))
    return found


def _table(head: list[str], rows: list[list[str]]) -> list[str]:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return [*lines, *("| " + " | ".join(r) + " |" for r in rows), ""]


def markdown(score: Score, about: Mapping[str, str] | None = None) -> str:
    """A section with the bars, the figures and the commonest confusions.

    about: what the caller knows, as date, commit and command; printed above the tables.
    """
    counts = Counter(v.kind for v in score.rows)
    kinds = ", ".join(f"{n} {k}" for k, n in sorted(counts.items()))
    lines = [f"## Blind run, seed {score.seed}", ""]
    lines += [f"- {key}: {value}" for key, value in (about or {}).items()]
    lines += [
        f"- cases: {len(score.rows)} ({kinds}), fraction {score.fraction:g}",
        f"- root hash of the commitments: `{score.root}`",
        "",
    ]
    words = {True: "met", False: "**missed**", None: "no case"}
    lines += _table(
        ["bar", "wanted", "measured (95 % interval)", ""],
        [[b.what, b.wanted, b.measured, words[b.met]] for b in bars(score)],
    )
    lines += _table(["figure", "measured"], [[k, str(s)] for k, s in score.shares.items()])
    said = [
        f"median {median:.3f}, 85 % quantile {high:.3f}, within 1.2 in {100 * share:.0f} %"
        for median, high, share in (score.nrmse_ratio, score.noise_ratio)
    ]
    middle, mean, longest = score.seconds
    lines += [
        f"Multi-label F1: micro {score.f1_micro:.3f}, macro {score.f1_macro:.3f}. "
        f"NRMSE after over the oracle's (true structure, fitted): {said[0]}; over the noise alone: "
        f"{said[1]}. Parameters within two standard errors: "
        f"{score.within_two_sigma}. Seconds per case: median {middle:.1f}, mean {mean:.1f}, "
        f"longest {longest:.1f}.",
        "",
    ]
    lines += _table(
        ["effect", "recall", "precision"],
        [[e, str(r), str(p)] for e, (r, p) in score.per_effect.items() if r.n or p.n],
    )
    lines += _table(
        ["stated confidence", "mean stated", "right", "names"],
        [
            [f"{a:.2f} to {b:.2f}", f"{m:.3f}", f"{right:.3f}", str(n)]
            for a, b, m, n, right in score.calibration
        ],
    )
    lines += _table(
        ["parameter", "n", "median relative error", "90 % quantile"],
        [[k, str(n), f"{m:.2g}", f"{q:.2g}"] for k, (n, m, q) in score.parameter_errors.items()],
    )
    wrong: Counter[tuple[str, str]] = Counter()
    oracle: Counter[tuple[str, str]] = Counter()
    for v in score.rows:
        if v.kind == "single" and not v.exact:
            pair = "+".join(v.true), "+".join(v.named) or v.verdict
            wrong[pair] += 1
            oracle[pair] += bool(set(v.named) & set(v.inseparable))
    lines += _table(
        ["truth of a single", "answered", "times", "of these inseparable for the oracle"],
        [[t, a, str(n), str(oracle[t, a])] for (t, a), n in wrong.most_common(25)],
    )
    return "\n".join(lines).replace("nan", "none")
