"""A table of dry friction told in noise: its levels as alike as those of rails and bearings are.

Eighteen levels, each free, cost more than what noise lets them say of one that goes by position. Believed
of the levels L (1 + d) about a plain level L, d Gaussian with

    K_ij = SPREAD^2 exp(-((x_i - x_j)/REACH)^2/2), times EITHER_WAY between the two directions,

x in shares of the travel. A fit that found d^ with the information R'R, of all other numbers not known (the
last rows of a QR of the whitened derivatives), says of them, with K = C C', z = C^-1 d and Laplace's
approximation,

    log p(table) - log p(plain) = l(d^) - l(0) - min |[R C; I] z - [R d^; 0]|^2/2 - sum log |diag Q|,

Q the triangle of [R C; I], and its least z is the table believed: one that the data do not see is plain.
(Levels that go up and down by 0.25 to 0.5, their trace as loud as the noise: 9, 22, 27 and 298 of
log-likelihood beyond plain friction, where 17 numbers more cost 68; by this -1, 10, 15 and 273. Of
plain friction, 5 to 21 beyond it: -5 to 1.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg

from ffl.diagnose.contest.judging import PER_NUMBER, Judged
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.triangle import triangle
from ffl.diagnose.predict.foretold import refitted
from ffl.diagnose.predict.slipping import Slip
from ffl.systems.state_space import Array

SPREAD = 0.35  # of a plain level
REACH = 0.2  # of the travel
EITHER_WAY = 0.5  # correlation between the directions
ROUND = 1e-9  # of K's diagonal, which rounding may take away


def smoothed(table: Slip, plain: Judged, scene: Scene, held: Scene) -> Judged | None:
    """The fitted `table` as it is believed beside the `plain` level, all else fitted again; what its
    levels cost is what they are worth less than they fit. None: no such plant, or no level."""
    fit, level = table.fit(scene.trials), plain.model.effects[-1].parameters["level"]
    if fit is None or level <= 0.0:
        return None
    at = [k for k, c in enumerate(table.model.coordinates) if c.place is not None]
    information = _information(fit.jacobian / np.sqrt(np.mean(fit.white**2)), at, table) * level
    off = table.theta[at] / level - 1.0
    believed, price = _believed(information, off)
    theta = table.theta
    theta[at] = level * np.maximum(1.0 + believed, 0.0)
    found, fitted = refitted(table.at(theta), scene.trials, fixed=at).in_its_noise(scene.trials)
    judged = found.judged(scene, held, fitted)
    if judged is None:
        return None
    worth = table.scaled(scene.trials)[0] - price - PER_NUMBER * plain.freedom
    return replace(judged, price=fitted - worth)


def _information(jacobian: Array, at: Sequence[int], table: Slip) -> Array:
    """R (k, k) of the coordinates `at`, whatever the others are within what is believed of them."""
    others = [k for k in range(jacobian.shape[1]) if k not in at]
    doubts = np.array([table.model.coordinates[k].doubt for k in others])
    prior = np.zeros((len(others), jacobian.shape[1]))
    prior[:, : len(others)] = np.diag(1.0 / doubts)
    rows = np.vstack([jacobian[:, [*others, *at]], prior])
    whole = triangle(rows, np.zeros(len(rows)))[0]
    return whole[len(others) :, len(others) :]


def _believed(information: Array, off: Array) -> tuple[Array, float]:
    """(levels off a plain one as they are believed, by how much less they are worth than they fit)."""
    n = len(off) // 2
    x = np.tile(np.linspace(0.0, 1.0, n), 2)
    way = np.repeat([0, 1], n)
    k = np.exp(-0.5 * ((x[:, None] - x) / REACH) ** 2)
    k = SPREAD**2 * (k * np.where(way[:, None] == way, 1.0, EITHER_WAY) + ROUND * np.eye(2 * n))
    root = scipy.linalg.cholesky(k, lower=True)
    told = np.vstack([information @ root, np.eye(2 * n)])
    wanted = np.concatenate([information @ off, np.zeros(2 * n)])
    r, seen = triangle(told, wanted)
    z = scipy.linalg.solve_triangular(r, seen)
    left = wanted - told @ z
    return root @ z, float(0.5 * left @ left + np.sum(np.log(np.abs(np.diag(r)))))
