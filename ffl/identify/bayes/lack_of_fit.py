"""Do the taps suffice? The noise that the FIR inverse leaves, beside that of a free forward model.

A forward system whose inverse is long (slow zeros, inside or outside) is not 1/theta with few taps.
What is left over then looks like noise, and the taps bend to make it small where y is large.
On the 2018 loop (zeros at 0.985 and 1.02) eight taps left 38 times the noise and a fit of -2474.
"""

import numpy as np
from scipy.stats import f as fisher

from ffl.identify.bayes.records import Record

DOUBT, BEYOND_DOUBT = 1e-3, 1e-5  # p-values


def lack_of_fit(record: Record, misfit: float, n_taps: int) -> tuple[float, float]:
    """Ratio of noise variances (taps over free forward FIR model), and the p-value of its F test.

    The free model has as many coefficients as the record, but no more than half its samples: a
    forward response cut short leaves more, so that the ratio errs to the small side. nan, nan where
    that leaves no more than the taps: nothing to compare.
    """
    n_free = min(len(record.target), record.n_samples // 2)
    floor = record.floor + float(np.sum(record.target[n_free:] ** 2))
    if n_free <= n_taps or floor <= 0:
        return float("nan"), float("nan")
    free = record.n_samples - n_free
    ratio = (misfit / (record.n_samples - n_taps)) / (floor / free)
    extra = (misfit - floor) / (n_free - n_taps)
    p = fisher.sf(max(extra, 0.0) / (floor / free), n_free - n_taps, free)
    return float(ratio), float(p)


def remark(ratio: float, p: float, n_taps: int) -> str | None:
    """One sentence where the taps leave more than noise: a tenth more, or beyond doubt.

    Less than a tenth spoils nothing but the standard errors, which know noise alone: taps cut at 9 % of
    the largest (a zero at 1.05, 50 + 50 taps) left 1.05 times the noise, with errors of 7 deviations.
    """
    if np.isnan(p) or p > (DOUBT if ratio >= 1.1 else BEYOND_DOUBT):
        return None
    said = f"{n_taps} taps leave {ratio:.3g} times the noise of a free forward model (p = {p:.1g})"
    if ratio < 1.1:
        said += ", which the standard errors do not count"
    return f"{said}: take more taps, or a rational basis where the system has slow zeros"
