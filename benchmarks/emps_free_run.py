"""Laws of friction fitted to DATA_EMPS, and what they leave of it and of PULSES by the published
open-loop protocol of the EMPS benchmark.

    python benchmarks/emps_free_run.py [--delay 0.3] [--choose] [--json]

Two laws are fitted to the balance of forces below 25 Hz. The others are fitted to the free run itself,
Coulomb friction being a polynomial over position for each direction, taken at so many places and straight
between them: least sum of squares of y - yhat under the recorded command and under that with `DRIFT`
newtons more and less. Those are predictors of one trajectory, no physics: the columns of the force and of
the least level say so. Nothing is fitted to PULSES.

`--delay` is how many samples late the command acts. `--choose` is about degree, places and kind of viscous
friction: each half of DATA_EMPS is fitted and runs freely over the other, PULSES beside it.
"""

from __future__ import annotations

import argparse
import json
import sys
from itertools import product
from typing import Any

import numpy as np
import scipy.optimize
import scipy.signal
from _emps_run import STEP, Array, Law, Part, rms
from _recordings import KNOWN, found
from emps_open_loop import OFFSETS, START

from ffl.errors import InputError
from ffl.recordings import read_recording

MASS = 94.8  # kg, of the balance of forces; the free run alone would put it anywhere from 89 to 120
DRIFT = 0.28  # N, half of what the load drifts by within DATA_EMPS
DEGREE, FEW, MANY = 6, 9, 65  # of the polynomials; places that they are taken at
CUT, SLOW, SETTLE = 25.0, 0.02, 200  # Hz, m/s, samples: what of the balance of forces counts
PENALTY = 100.0  # mm for a level 1 N below zero
MOST_RUNS = 150


class Balance:
    """Force, velocity and acceleration below `CUT`, away from standstill, reversals and ends."""

    def __init__(self, part: Part) -> None:
        filt = scipy.signal.butter(4, 2 * CUT * STEP)
        beside = 0.5 * (part.force + np.r_[part.force[0], part.force[:-1]])
        x, force = (scipy.signal.filtfilt(*filt, z) for z in (part.y, beside))
        v = np.gradient(x, STEP)
        a, sign = np.gradient(v, STEP), np.sign(v)
        counts = (np.abs(v) > SLOW) & (np.abs(scipy.signal.filtfilt(*filt, sign) - sign) < SLOW)
        counts[:SETTLE] = counts[-SETTLE:] = False
        kept = (z[counts][::10] for z in (x, v, a, sign, force))
        self.x, self.v, self.a, self.sign, self.force = kept

    def fitted(self, by_direction: bool) -> Law:
        speeds = [np.maximum(self.v, 0), np.minimum(self.v, 0)] if by_direction else [self.v]
        columns = [self.a, self.sign, np.ones_like(self.v), *speeds]
        mass, level, load, *b = np.linalg.lstsq(np.column_stack(columns), self.force, rcond=None)[0]
        return Law(mass, load, (b[0], b[-1]), np.full(2, level), np.full(2, level))

    def left(self, law: Law) -> float:
        level = np.where(self.sign > 0, *law.levels(self.x))
        friction = self.sign * level + np.where(self.sign > 0, *law.viscous) * self.v
        return rms(self.force - law.mass * self.a - law.load - friction)


def predictor(
    part: Part, begun: Law, degree: int, places: int, by_direction: bool, passive: bool = False
) -> Law:
    """The law of polynomials that leaves least of `part` in free runs under offsets of -`DRIFT`, 0 and
    `DRIFT`; `passive` holds levels and viscous friction above zero."""
    powers = np.vander(np.linspace(-1, 1, places), degree + 1, increasing=True)

    def law(z: Array) -> Law:
        b, rest = z[1 : 2 + by_direction], z[2 + by_direction :]
        up, down = (powers @ np.r_[rest[0], c] for c in np.split(rest[1:], 2))
        return Law(MASS, z[0], (b[0], b[-1]), up, down)

    def left(z: Array) -> Array:
        tried = law(z)
        errors = [part.errors(tried, o)[::START] for o in (-DRIFT, 0.0, DRIFT)]
        if passive:
            errors += [PENALTY * np.minimum(c, 0) for c in (tried.up, tried.down, tried.viscous)]
        return np.concatenate(errors)

    viscous = begun.viscous if by_direction else begun.viscous[:1]
    start = np.r_[begun.load, viscous, begun.up[0], np.zeros(2 * degree)]
    scale = np.r_[0.3, np.full(len(viscous), 5.0), 0.5, np.full(2 * degree, 0.3)]

    def slopes(z: Array) -> Array:  # over steps that outlast the kinks of sticking
        steps = 0.05 * np.diag(scale)
        return np.column_stack([(left(z + h) - left(z - h)) / (2 * h.sum()) for h in steps])

    found = scipy.optimize.least_squares(left, start, slopes, x_scale=scale, max_nfev=MOST_RUNS)
    return law(found.x)


def row(name: str, law: Law, balance: Balance, files: dict[str, Part]) -> dict[str, Any]:
    figures = {key: [round(rms(p.errors(law, o)), 2) for o in OFFSETS] for key, p in files.items()}
    return {
        "law": name,
        "force_rms_N": round(balance.left(law), 2),
        "viscous_N_s_per_m": [round(b, 1) for b in law.viscous],
        "least_level_N": round(float(np.min([law.up, law.down])), 1) + 0.0,  # no -0
        **{f"{key}_rmse_mm": figure for key, figure in figures.items()},
    }


def across(part: Part, begun: Law, *kind: Any) -> float:
    """RMSE in mm of either half by what was fitted to the other."""
    middle = len(part.y) // 2
    first, second = part.cut(slice(middle)), part.cut(slice(middle, None))
    pairs = ((first, second), (second, first))
    return rms(np.concatenate([b.errors(predictor(a, begun, *kind)) for a, b in pairs]))


def rows_of(files: dict[str, Part], choose: bool) -> list[dict[str, Any]]:
    part = files["DATA_EMPS"]
    balance = Balance(part)
    plain = balance.fitted(by_direction=False)
    if choose:
        kinds = product((FEW, MANY), (False, True), range(2, DEGREE + 1))
        return [
            row(f"degree {n}, {places} places" + ", b by direction" * b,
                predictor(part, plain, n, places, b), balance, files)
            | {"across_halves_mm": round(across(part, plain, n, places, b), 2)}
            for places, b, n in kinds
        ]  # fmt: skip
    laws = {
        "balance of forces, one b": plain,
        "balance of forces, b by direction": balance.fitted(by_direction=True),
        f"free run, {FEW} places": predictor(part, plain, DEGREE, FEW, False),
        f"free run, {MANY} places": predictor(part, plain, DEGREE, MANY, False),
        f"{FEW} places, levels >= 0": predictor(part, plain, DEGREE, FEW, True, passive=True),
        f"{MANY} places, levels >= 0": predictor(part, plain, DEGREE, MANY, True, passive=True),
    }
    return [row(name, law, balance, files) for name, law in laws.items()]


def main() -> int:
    parser = argparse.ArgumentParser(description=" ".join(__doc__.split("\n\n")[0].split()))
    parser.add_argument("--delay", type=float, default=0.0, help="of the command, samples")
    parser.add_argument("--choose", action="store_true", help="every degree, half against half")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    case = KNOWN["emps"]
    try:
        read = [read_recording(found(file), case.mapping) for file in (*case.fit, *case.judge)]
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    names, parts = ("DATA_EMPS", "PULSES"), [Part.of(r, options.delay) for r in read]
    rows = rows_of(dict(zip(names, parts, strict=True)), options.choose)
    if options.json:
        print(json.dumps(rows, indent=1))
        return 0
    print("RMSE on DATA_EMPS, PULSES in mm at " + ", ".join(f"{o:+.1f}" for o in OFFSETS) + " N")
    print(f"{'law':34} {'force':>6} {'b up':>6} {'down':>6} {'least':>6}   (N, N s/m, N s/m, N)")
    for r in rows:
        forces = (r["force_rms_N"], *r["viscous_N_s_per_m"], r["least_level_N"])
        files = "   ".join(" ".join(f"{e:5.2f}" for e in r[f"{name}_rmse_mm"]) for name in names)
        halves = f"   halves {r['across_halves_mm']:.2f}" if options.choose else ""
        print(f"{r['law']:34} {' '.join(f'{z:6.2f}' for z in forces)}   {files}{halves}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
