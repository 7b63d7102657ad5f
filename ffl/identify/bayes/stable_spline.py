"""Non-causal stable spline kernel, equations (9) and (10) of the 2025 paper, and its rough rival."""

import numpy as np

from ffl.identify.kernels import DC

JITTER = 1e-5


def stable_spline(
    taps: np.ndarray, causal_decay: float, noncausal_decay: float, peak: int = 0
) -> np.ndarray:
    """Covariance of the taps at unit scale (alpha = 1), shape (n, n).

    k(t, t') = min(b, b')^2 (3 max(b, b') - min(b, b')) / 6,  b(t) = causal_decay^s for s >= 0 and
    noncausal_decay^-s for s < 0, s = t - peak. The paper has peak = 0.

    Where both decays are equal b(-s) = b(s), two taps have one value and (9) is singular: a jitter
    of 1e-5 of the mean variance (0.3 % in a tap) is added always, so that the likelihood is smooth in
    the decays. Between 1e-8 and 1e-4 the fit of Table I moves by 0.45, at 1e-3 it loses 1.8.
    """
    s = np.asarray(taps) - peak
    b = np.where(
        s >= 0, float(causal_decay) ** np.maximum(s, 0), float(noncausal_decay) ** np.maximum(-s, 0)
    )
    low, high = np.minimum.outer(b, b), np.maximum.outer(b, b)
    return _jittered(low**2 * (3 * high - low) / 6)


def correlated(
    taps: np.ndarray,
    causal_decay: float,
    noncausal_decay: float,
    correlation: float,
    peak: int = 0,
) -> np.ndarray:
    """k(t, t') = (b b')^(3/2) correlation^|t - t'|: variance of (9) but for 1/3, not its smoothness.

    Negative: taps that alternate in sign. The DC kernel of Chen, Ohlsson and Ljung (2012), with the
    jitter of (9).
    """
    kernel = DC(
        decay_causal=causal_decay**3,
        decay_anticausal=noncausal_decay**3,
        peak=peak,
        correlation=correlation,
    )
    return _jittered(kernel.matrix(np.asarray(taps)))


def _jittered(kernel: np.ndarray) -> np.ndarray:
    return kernel + JITTER * np.trace(kernel) / len(kernel) * np.eye(len(kernel))
