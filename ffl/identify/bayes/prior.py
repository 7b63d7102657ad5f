"""Prior of the inverse taps with its hyperparameters integrated out.

theta | alpha, h ~ N(0, alpha K_h), (5) and (9), with a node h = (peak, causal decay, non-causal
decay, and where asked the correlation of neighbours) on a grid of equal weights, and d alpha / alpha
for the scale, which integrates in closed form:

    p(theta) = sum_h w_h |K_h|^-1/2 (theta' K_h^-1 theta)^-n/2   (times a constant).

So no hyperparameter is chosen at all, units do not matter, and the posterior of theta stands in n
dimensions with a density that costs microseconds.

The decays run over geometric grids, those for t < peak half a step from those for t >= peak: on equal
decays (9) is singular, says that theta is symmetric about its peak, and a grid that has such nodes
scatters the fit by a point up or down with where its nodes happen to fall.

(9) says that the taps are smooth. The inverse of a plant that is weak at high frequency is not: its
first taps alternate in sign, the record is weak in that very direction, and the prior fills it in with
errors of up to eight of its own deviations (zeros 0.6 and -0.3, poles 0.92 and 0.8 +- 0.3i, 2 % noise,
6000 samples). `CORRELATIONS` are the rivals that the evidence decides between: 41 nats for -0.5 there.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from ffl.identify.bayes.stable_spline import correlated, stable_spline

LEAST_DECAY, LARGEST_DECAY = 0.02, 0.9
CORRELATIONS = (-0.8, -0.5, 0.0, 0.5, 0.8)  # of neighbours, beside (9)


@dataclass(frozen=True)
class Node:
    """One setting of the kernel: (9), or `correlated` where a correlation of neighbours is given."""

    peak: int
    causal_decay: float
    noncausal_decay: float
    correlation: float | None = None

    def kernel(self, taps: np.ndarray) -> np.ndarray:
        """K_h at unit scale."""
        shape = self.causal_decay, self.noncausal_decay
        if self.correlation is None:
            return stable_spline(taps, *shape, self.peak)
        return correlated(taps, *shape, self.correlation, self.peak)


@dataclass(frozen=True)
class Prior:
    """Nodes with their precision factors: K_h^-1 = W_h' W_h, W_h lower triangular."""

    nodes: tuple[Node, ...]
    white: np.ndarray  # (n_nodes, n, n)
    log_weight: np.ndarray  # (n_nodes,): log w_h - 1/2 log |K_h|
    precision: np.ndarray  # (n_nodes, n, n)

    def restricted(self, kept: np.ndarray) -> "Prior":
        """The same prior without the nodes that the data have ruled out."""
        return Prior(
            tuple(self.nodes[k] for k in kept),
            self.white[kept],
            self.log_weight[kept],
            self.precision[kept],
        )

    @staticmethod
    def joined(priors: "list[Prior]") -> "Prior":
        """Mixture with equal weights of priors on the same taps."""
        return Prior(
            tuple(node for prior in priors for node in prior.nodes),
            np.concatenate([prior.white for prior in priors]),
            np.concatenate([prior.log_weight for prior in priors]) - np.log(len(priors)),
            np.concatenate([prior.precision for prior in priors]),
        )

    def log_density(self, thetas: np.ndarray) -> np.ndarray:
        """log p of every row, up to a constant; O(rows nodes n^2)."""
        return _log_density(np.ascontiguousarray(thetas), self.white, self.log_weight)

    def responsibilities(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """p(h | theta), and the quadratic forms theta' K_h^-1 theta."""
        quadratic = np.sum((self.white @ theta) ** 2, axis=1)
        log = self.log_weight - 0.5 * len(theta) * np.log(quadratic)
        share = np.exp(log - log.max())
        return share / share.sum(), quadratic


def grid_prior(
    n_ac: int,
    n_c: int,
    peaks: tuple[int, ...],
    n_decays: int = 12,
    largest_decay: float = LARGEST_DECAY,
    correlation: float | None = None,
) -> Prior:
    """All combinations of peak and decays, 0.02 to `largest_decay`, on the taps -n_ac..n_c-1."""
    taps = np.arange(-n_ac, n_c)
    decays = np.geomspace(LEAST_DECAY, largest_decay, 2 * n_decays)
    nodes = tuple(
        Node(p, float(c), float(a), correlation)
        for p in peaks
        for c in decays[0::2]
        for a in decays[1::2]
    )
    roots = np.linalg.cholesky(np.stack([node.kernel(taps) for node in nodes]))
    white = np.ascontiguousarray(np.linalg.inv(roots))
    log_det = np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1)
    return Prior(nodes, white, -log_det - np.log(len(nodes)), white.swapaxes(1, 2) @ white)


def peaks_around(theta: np.ndarray, n_ac: int, reach: int = 1) -> tuple[int, ...]:
    """Candidate peaks: the taps within `reach` of the largest one."""
    largest = int(np.argmax(np.abs(theta)))
    low, high = max(0, largest - reach), min(len(theta) - 1, largest + reach)
    return tuple(range(low - n_ac, high - n_ac + 1))


@njit(cache=True)
def _log_density(thetas, white, log_weight):
    m, n = thetas.shape
    out, log = np.empty(m), np.empty(len(white))
    for k in range(m):
        for h in range(len(white)):
            quadratic = 0.0
            for i in range(n):
                e = 0.0
                for j in range(i + 1):
                    e += white[h, i, j] * thetas[k, j]
                quadratic += e * e
            log[h] = log_weight[h] - 0.5 * n * np.log(quadratic)
        top = log.max()
        total = 0.0
        for h in range(len(white)):
            if log[h] > top - 36.0:
                total += np.exp(log[h] - top)
        out[k] = top + np.log(total)
    return out
