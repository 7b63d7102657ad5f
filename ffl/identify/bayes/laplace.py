"""Mode of the posterior, and one Gaussian with its evidence for every node of the prior."""

from dataclasses import dataclass

import numpy as np

from ffl.identify.bayes.circle import inside_count
from ffl.identify.bayes.prior import Prior
from ffl.identify.bayes.records import Record
from ffl.identify.regression import upper_triangle


@dataclass(frozen=True)
class Laplace:
    """Gaussian approximations of p(theta | y, h), shape (n_nodes, ...), and log p(y | h)."""

    means: np.ndarray
    covariances: np.ndarray
    log_evidence: np.ndarray

    def heaviest(self, share: float, at_most: int) -> tuple[np.ndarray, np.ndarray]:
        """Indices and weights of the nodes that carry `share` of the evidence."""
        weight = np.exp(self.log_evidence - self.log_evidence.max())
        weight /= weight.sum()
        order = np.argsort(-weight)
        n = min(at_most, int(np.searchsorted(np.cumsum(weight[order]), share)) + 1)
        kept = order[:n]
        return kept, weight[kept] / weight[kept].sum()

    def moments(self, centre: np.ndarray, temper: float) -> "Moments":
        """Moments about `centre` under weights evidence^(1 / temper)."""
        log = self.log_evidence / temper
        weight = np.exp(log - log.max())
        off = self.means - centre
        return Moments(
            float(log.max()),
            float(weight.sum()),
            weight @ off,
            np.tensordot(weight, self.covariances, 1) + off.T @ (off * weight[:, None]),
        )

    def restricted(self, kept: np.ndarray) -> "Laplace":
        """The same approximation at some of the nodes."""
        return Laplace(self.means[kept], self.covariances[kept], self.log_evidence[kept])


@dataclass(frozen=True)
class Moments:
    """Unnormalised moments of theta - centre, weights in units of exp(log_top)."""

    log_top: float
    total: float
    first: np.ndarray
    second: np.ndarray

    @staticmethod
    def pooled(parts: "list[Moments]") -> "Moments":
        """Moments of all parts, normalised."""
        top = max(part.log_top for part in parts)
        share = np.array([np.exp(part.log_top - top) for part in parts])
        total = float(share @ [part.total for part in parts])
        return Moments(
            top + np.log(total),
            1.0,
            share @ np.stack([part.first for part in parts]) / total,
            np.tensordot(share, np.stack([part.second for part in parts]), 1) / total,
        )

    def about(self, off: np.ndarray) -> np.ndarray:
        """Mean square error of centre + `off`: E (theta - centre - off)(theta - centre - off)'."""
        cross = np.outer(self.first, off)
        return self.second - cross - cross.T + np.outer(off, off)


def posterior_mode(
    record: Record, prior: Prior, theta: np.ndarray, n_ac: int, max_steps: int = 40
) -> np.ndarray:
    """Maximum of -N/2 log ||y - U xi||^2 + log p(theta), from `theta`, in its root label.

    The noise variance is integrated out under d sigma^2 / sigma^2. Gauss-Newton on the misfit, and on
    the prior the precision of the nodes weighted with p(h | theta) (as in EM). Solved as one
    stacked least-squares problem.
    """
    inside = inside_count(theta, n_ac)
    n = len(theta)

    def cost(t, xi):
        return 0.5 * record.n_samples * np.log(record.misfit(xi)) - prior.log_density(t[None])[0]

    xi, slope = record.jacobian(theta, n_ac)
    value, damping = cost(theta, xi), 0.0
    for _ in range(max_steps):
        noise = np.sqrt(record.misfit(xi) / record.n_samples)
        share, quadratic = prior.responsibilities(theta)
        precision = np.einsum("h,hij->ij", share * n / quadratic, prior.precision)
        root = np.linalg.cholesky(precision).T
        stacked = np.vstack([record.factor @ slope / noise, root])
        right = np.concatenate([(record.target - record.factor @ xi) / noise, -root @ theta])
        scale = np.sqrt(np.sum(stacked**2, axis=0))
        while damping < 1e8:
            rows = np.vstack([stacked, np.sqrt(damping) * np.diag(scale)])
            step = np.linalg.lstsq(rows, np.concatenate([right, np.zeros(n)]), rcond=None)[0]
            trial = theta + step
            trial_value = cost(trial, record.response(trial, n_ac))
            if trial_value < value and inside_count(trial, n_ac) == inside:
                break
            damping = max(10 * damping, 1e-3)
        else:
            break
        gain = value - trial_value
        theta, value, damping = trial, trial_value, damping / 10 if damping > 1e-4 else 0.0
        xi, slope = record.jacobian(theta, n_ac)
        if gain < 1e-5:
            break
    return theta


def laplace_per_node(
    record: Record, prior: Prior, theta: np.ndarray, n_ac: int, sweeps: int = 12
) -> Laplace:
    """Posterior of every node with xi(theta) linear around `theta`; scale and noise by fixed point.

    With r = linear misfit and q = theta' K^-1 theta the density is r^-N/2 q^-n/2 |K|^-1/2; its mode is
    where theta solves the ridge problem with noise r/N and scale q/n, its width is that problem's.
    """
    n, samples = len(theta), record.n_samples
    xi, slope = record.jacobian(theta, n_ac)
    jacobian = record.factor @ slope
    triangle = upper_triangle(
        np.column_stack([jacobian, record.target - record.factor @ xi + jacobian @ theta])
    )
    factor, target = triangle[:n, :n], triangle[:n, n]
    floor = record.floor + float(np.sum(triangle[n:, n] ** 2))
    gram, pull = factor.T @ factor, factor.T @ target
    means = np.broadcast_to(theta, (len(prior.nodes), n)).copy()
    misfit = np.full(len(means), record.misfit(xi))
    for _ in range(sweeps):
        quadratic = np.sum(np.einsum("hij,hj->hi", prior.white, means) ** 2, axis=1)
        noise = misfit / samples
        hessian = gram / noise[:, None, None] + prior.precision * (n / quadratic)[:, None, None]
        means = np.linalg.solve(hessian, (pull / noise[:, None])[:, :, None])[:, :, 0]
        misfit = np.sum((target - means @ factor.T) ** 2, axis=1) + floor
    quadratic = np.sum(np.einsum("hij,hj->hi", prior.white, means) ** 2, axis=1)
    covariances = np.linalg.inv(hessian)
    log_evidence = (
        -0.5 * samples * np.log(misfit)
        - 0.5 * n * np.log(quadratic)
        + prior.log_weight
        - 0.5 * np.linalg.slogdet(hessian)[1]
        + 0.5 * n * np.log(2 * np.pi)
    )
    return Laplace(means, 0.5 * (covariances + covariances.swapaxes(1, 2)), log_evidence)
