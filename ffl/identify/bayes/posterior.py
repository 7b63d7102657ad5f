"""The better way: the posterior of the inverse taps itself, hyperparameters integrated out.

Maximum likelihood from several starts -> mode of the posterior -> Laplace evidence of every kernel
setting -> importance sampling from their mixture -> posterior mean. Beside Algorithm 1 it has no EM
loop to converge, no single hyperparameter to be wrong about, and an error of the sampling that is
reported. Where the effective sample size is low, Metropolis-Hastings chains on the same density.
"""

from dataclasses import dataclass, replace

import numpy as np

from ffl.errors import InputError
from ffl.identify.bayes.circle import inside_count
from ffl.identify.bayes.importance import WeightedDraws, importance_sample
from ffl.identify.bayes.lack_of_fit import lack_of_fit, remark
from ffl.identify.bayes.laplace import Laplace, Moments, laplace_per_node, posterior_mode
from ffl.identify.bayes.maximum_likelihood import (
    MaximumLikelihood,
    check_explained,
    maximum_likelihood,
    starts,
    wrong_side,
)
from ffl.identify.bayes.metropolis import Chains, metropolis
from ffl.identify.bayes.prior import (
    CORRELATIONS,
    LARGEST_DECAY,
    Node,
    Prior,
    grid_prior,
    peaks_around,
)
from ffl.identify.bayes.records import Record

SAMPLING_LIMIT = 12  # taps: beyond, importance weights degenerate and the mode stands alone
COUNTED_TAPS = 4  # what the evidence of a kernel counts for in the errors, see `_rough_or_smooth`


@dataclass(frozen=True)
class KernelPosterior:
    """What the data say about the kernel: probabilities of the peaks, means of the rest."""

    peak: dict[int, float]
    causal_decay: float
    noncausal_decay: float
    scale: float
    best: Node


@dataclass(frozen=True)
class Posterior:
    """Posterior of theta given (u, y).

    `status`: "importance" (weighted draws), "chains" (Metropolis-Hastings, because the weights were
    poor), "unconverged" (the chains disagree too, split R-hat above 1.1: do not use the answer without
    asking why; too few taps is the usual reason), "mode" (more than 12 taps: not sampled).
    `effective_sample_size` belongs to what `status` names (the least over the taps for chains, nan for
    the mode); `importance_ess` is that of the weighted draws in any case. `noise_ratio`, `lack_of_fit`:
    see `lack_of_fit`; `remarks` says it in words.
    """

    n_ac: int
    theta: np.ndarray
    covariance: np.ndarray
    mode: np.ndarray
    noise_variance: float
    kernel: KernelPosterior
    likelihood: MaximumLikelihood
    status: str
    effective_sample_size: float
    importance_ess: float
    log_evidence: float
    chains: Chains | None
    noise_ratio: float = float("nan")
    lack_of_fit: float = float("nan")

    @property
    def remarks(self) -> tuple[str, ...]:
        """What must be said with the answer, in sentences; empty where nothing speaks against it."""
        found = [remark(self.noise_ratio, self.lack_of_fit, len(self.theta))]
        if self.status == "unconverged" and self.chains is not None:
            found.append(
                f"unconverged: the chains disagree (split R-hat {self.chains.rhat.max():.2f}, 1 where "
                "they agree), so this is no answer yet; take more taps (too few are the usual reason), "
                "or record longer or with more power"
            )
        return tuple(sentence for sentence in found if sentence)


def direct_posterior(
    record: Record,
    n_ac: int,
    n_c: int,
    rng: np.random.Generator,
    n_draws: int = 3000,
    n_decays: int = 12,
    peak_reach: int = 1,
    least_ess: float = 100.0,
    likelihood: MaximumLikelihood | None = None,
) -> Posterior:
    """Posterior mean of the taps -n_ac..n_c-1, with everything said about how it came about.

    Cost: O(N length^2) once (in `reduce_record`), then about n_draws (length^2 + nodes n^2) whatever N.
    """
    if n_draws < 100:
        raise InputError(f"{n_draws} draws cannot carry a posterior mean: take 100 or more")
    if n_ac + n_c > SAMPLING_LIMIT:
        found = _mode_only(record, n_ac, n_c, n_decays, peak_reach)
    else:
        start = likelihood or maximum_likelihood(record, n_ac, n_c)
        found = _sampled(record, start, n_ac, rng, n_draws, n_decays, peak_reach, least_ess)
    misfit = record.misfit(record.response(found.mode, n_ac))
    ratio, p = lack_of_fit(record, misfit, n_ac + n_c)
    return replace(found, noise_ratio=ratio, lack_of_fit=p)


def _sampled(
    record: Record,
    start: MaximumLikelihood,
    n_ac: int,
    rng: np.random.Generator,
    n_draws: int,
    n_decays: int,
    peak_reach: int,
    least_ess: float,
) -> Posterior:
    """Importance sampling around the mode, chains where its weights are poor."""
    n_c = len(start.theta) - n_ac
    prior = grid_prior(n_ac, n_c, peaks_around(start.theta, n_ac, peak_reach), n_decays)
    mode = posterior_mode(record, prior, start.theta, n_ac)
    laplace = laplace_per_node(record, prior, mode, n_ac)
    # nodes that the data rule out add less than 1e-4 to any density and cost as much as the others
    kept, _ = laplace.heaviest(1 - 1e-4, len(prior.nodes))
    prior = prior.restricted(kept)
    laplace = laplace.restricted(kept)
    drawn = importance_sample(record, prior, laplace, n_ac, start.inside, rng, n_draws)
    ess = drawn.effective_sample_size
    if ess >= least_ess:
        noise = float(drawn.weights @ drawn.misfits) / (record.n_samples - 2)
        return Posterior(
            n_ac,
            drawn.mean,
            drawn.covariance,
            mode,
            noise,
            _kernel(prior, drawn.thetas, drawn.weights),
            start,
            "importance",
            ess,
            ess,
            drawn.log_evidence,
            None,
        )
    return _from_chains(record, prior, laplace, drawn, mode, start, n_ac, rng)


def _from_chains(
    record: Record,
    prior: Prior,
    laplace: Laplace,
    drawn: WeightedDraws,
    mode: np.ndarray,
    start: MaximumLikelihood,
    n_ac: int,
    rng: np.random.Generator,
) -> Posterior:
    """Four chains on the same density, from the mode of the node with the most evidence."""
    heaviest = int(np.argmax(laplace.log_evidence))
    chains = metropolis(
        record,
        prior.white,
        prior.log_weight,
        0.0,
        mode,
        laplace.covariances[heaviest],
        n_ac,
        rng,
        n_draws=12_000,
        burn_in=2_000,
        n_chains=4,
    )
    agree = float(chains.rhat.max()) < 1.1
    flat = chains.draws[:, ::10].reshape(-1, len(mode))
    return Posterior(
        n_ac,
        chains.mean,
        chains.second_moment - np.outer(chains.mean, chains.mean),
        mode,
        chains.mean_misfit / (record.n_samples - 2),
        _kernel(prior, flat, np.full(len(flat), 1 / len(flat))),
        start,
        "chains" if agree else "unconverged",
        float(chains.effective_sample_size.min()),
        drawn.effective_sample_size,
        drawn.log_evidence,
        chains,
    )


def _mode_only(record: Record, n_ac: int, n_c: int, n_decays: int, peak_reach: int) -> Posterior:
    """The mode, with the covariance and the evidence of its neighbourhood; no sampling.

    Maximum likelihood is no start here: with 75 taps on a resonant system it went to a fit of -700
    while every first guess was above 85. The mode is sought from each guess, the highest stands.
    Decays reach as far as the taps do: with a zero at 1.08 and 80 + 20 taps a grid that ended at 0.9
    left 66 to 84 % of the taps within two standard errors, instead of 93 to 100 %.
    """
    best = None
    slowest = max(LARGEST_DECAY, 1 - 1 / (n_ac + n_c))
    for name, guess in starts(record, n_ac, n_c).items():
        if (inside := inside_count(guess, n_ac)) < n_c - 1:
            continue
        peaks = peaks_around(guess, n_ac, peak_reach)
        prior = grid_prior(n_ac, n_c, peaks, n_decays, slowest)
        mode = posterior_mode(record, prior, guess, n_ac, max_steps=100)
        misfit = record.misfit(record.response(mode, n_ac))
        value = -0.5 * record.n_samples * np.log(misfit) + prior.log_density(mode[None])[0]
        if best is None or value > best[0]:
            best = value, prior, mode, MaximumLikelihood(mode, misfit, inside, name, 0)
    if best is None:
        raise wrong_side(n_ac, n_c)
    _, prior, mode, start = best
    check_explained(record, start, n_ac, n_c)
    prior, mode, covariance, log_evidence = _rough_or_smooth(
        record, prior, mode, n_ac, n_decays, slowest
    )
    return Posterior(
        n_ac,
        mode,
        covariance,
        mode,
        record.misfit(record.response(mode, n_ac)) / (record.n_samples - 2),
        _kernel(prior, mode[None], np.ones(1)),
        start,
        "mode",
        float("nan"),
        float("nan"),
        log_evidence,
        None,
    )


def _rough_or_smooth(
    record: Record, smooth: Prior, mode: np.ndarray, n_ac: int, n_decays: int, slowest: float
) -> tuple[Prior, np.ndarray, np.ndarray, float]:
    """Prior with the rough kernels beside the smooth one where the evidence is for them; the mode, its
    mean square error and the log evidence under it.

    The error is that over all nodes, each weighted with evidence^(4 / n): the evidence takes the n taps
    for draws of the kernel, but those of a plant with few poles follow from few numbers. With a zero at
    -1.5 (20 + 20 taps, 3000 samples, 5 % noise), at full weight, the envelope that three large taps
    choose left the small ones off by 4.4 deviations (rms, up to 11); at this weight 1.6.
    One correlation at a time, so that memory stays that of one grid.
    """
    peaks = tuple(sorted({node.peak for node in smooth.nodes}))
    n_c, temper = len(mode) - n_ac, max(1.0, len(mode) / COUNTED_TAPS)
    priors, evidence, moments = [], [], []
    for correlation in (None, *CORRELATIONS):
        prior, guess = smooth, mode
        if correlation is not None:
            prior = grid_prior(n_ac, n_c, peaks, n_decays, slowest, correlation)
            guess = posterior_mode(record, prior, mode, n_ac, max_steps=100)
        laplace = laplace_per_node(record, prior, guess, n_ac)
        moments.append(laplace.moments(mode, temper))
        kept, _ = laplace.heaviest(1 - 1e-4, len(prior.nodes))
        priors.append(prior.restricted(kept))
        evidence.append(laplace.log_evidence[kept])
    log = np.concatenate(evidence)
    prior = Prior.joined(priors).restricted(np.flatnonzero(log > log.max() + np.log(1e-4)))
    final = posterior_mode(record, prior, mode, n_ac, max_steps=100)
    covariance = Moments.pooled(moments).about(final - mode)
    return prior, final, covariance, float(np.logaddexp.reduce(log) - np.log(len(priors)))


def _kernel(prior: Prior, thetas: np.ndarray, weights: np.ndarray) -> KernelPosterior:
    """p(h | y) averaged over the draws that carry weight, and E[alpha | theta, h] = q / (n - 2)."""
    n = thetas.shape[1]
    heavy = np.argsort(-weights)[:400]
    share, scale = np.zeros(len(prior.nodes)), 0.0
    for theta, weight in zip(thetas[heavy], weights[heavy] / weights[heavy].sum(), strict=True):
        p, quadratic = prior.responsibilities(theta)
        share += weight * p
        scale += weight * float(p @ quadratic) / max(n - 2, 1)
    peaks = {node.peak: 0.0 for node in prior.nodes}
    for node, part in zip(prior.nodes, share, strict=True):
        peaks[node.peak] += float(part)
    return KernelPosterior(
        dict(sorted(peaks.items())),
        float(share @ [node.causal_decay for node in prior.nodes]),
        float(share @ [node.noncausal_decay for node in prior.nodes]),
        scale,
        prior.nodes[int(np.argmax(share))],
    )
