"""What says whether a chain can be trusted: effective sample size, split R-hat."""

import numpy as np


def split_rhat(chains: np.ndarray) -> np.ndarray:
    """Potential scale reduction of every parameter, each chain cut into halves.

    `chains` has shape (n_chains, n_draws, n). Between- over within-chain variance (Gelman et al.,
    Bayesian Data Analysis, 3rd ed., section 11.4); 1 where all halves agree, above 1.01 look again.
    Chains that do not move give infinity where they differ, and nan where they are the same.
    """
    m, draws, n = chains.shape
    half = draws // 2
    parts = chains[:, : 2 * half].reshape(m * 2, half, n)
    within = parts.var(axis=1, ddof=1).mean(axis=0)
    between = parts.mean(axis=1).var(axis=0, ddof=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.sqrt((half - 1) / half + between / within)


def effective_sample_size(chains: np.ndarray) -> np.ndarray:
    """Number of independent draws that would give a mean as precise, per parameter.

    m N / (1 + 2 sum rho_k), autocorrelations by FFT, averaged over chains with the variance of all of
    them as denominator, the sum cut by Geyer's initial monotone sequence.
    """
    m, draws, n = chains.shape
    grid = 1 << int(np.ceil(np.log2(2 * draws)))
    centred = chains - chains.mean(axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(centred, grid, axis=1)) ** 2
    covariance = np.fft.irfft(power, grid, axis=1)[:, :draws].mean(axis=0) / draws
    within = covariance[0] * draws / (draws - 1)
    total = covariance[0] + (chains.mean(axis=1).var(axis=0, ddof=1) if m > 1 else 0.0)
    out = np.empty(n)
    for i in range(n):
        if total[i] <= 0:
            out[i] = 0.0
            continue
        rho = 1 - (within[i] - covariance[:, i]) / total[i]
        rho[0] = 1.0
        pairs = rho[: 2 * (draws // 2)].reshape(-1, 2).sum(axis=1)
        negative = np.flatnonzero(pairs <= 0)
        pairs = np.minimum.accumulate(pairs[: negative[0]] if len(negative) else pairs)
        out[i] = m * draws / max(2 * pairs.sum() - 1, 1 / np.log10(m * draws + 10))
    return out
