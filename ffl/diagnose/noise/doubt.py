"""What the fitted recordings leave open about the linear model, granted when another one judges.

A mode that the fitted recordings hardly excite is corrected by chance, within its standard error. A
held-out recording that does excite it then shows a mismatch that is no physics, and every rival whose
corrections fell otherwise seems to explain it.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import Fit, jacobian
from ffl.systems.state_space import Array

OPEN = 1e6  # standard deviations of belief: what the data see no better than this they do not see


@dataclass(frozen=True)
class Doubt:
    """`columns` (N, k): d yhat/d number on the held-out recordings; `root` (k, k): square root of
    the numbers' posterior precision, root' root = covariance^-1 + belief; `chosen` (k,): which they are."""

    columns: Array
    root: Array
    chosen: tuple[int, ...]

    @classmethod
    def of(cls, held: Scene, fit: Fit, kinds: Collection[str] = ("correction",)) -> Doubt | None:
        """Of the numbers of these `kinds`; None where nothing is free, or the model runs away."""
        model = fit.model
        chosen = [k for k, c in enumerate(model.coordinates) if c.kind in kinds]
        base = held.residuals(model)
        if not chosen or base is None or not fit.jacobian.size:
            return None
        columns = jacobian(held, model, base, chosen=chosen)
        belief = np.array([model.coordinates[k].doubt for k in chosen])
        belief = np.where(np.isfinite(belief), belief, 1.0)
        share = fit.covariance[np.ix_(chosen, chosen)] / np.outer(belief, belief)
        values, vectors = np.linalg.eigh(np.nan_to_num(share, nan=OPEN**2, posinf=OPEN**2))
        root = np.sqrt(1.0 / np.maximum(values, 1e-18) + 1.0)[:, None] * vectors.T / belief
        return cls(columns, root, tuple(chosen))

    def settled(self, held: Scene, white: Array, known: Array | None = None) -> Array:
        """`white` (N,), the whitened held-out residual, less what corrections within their posterior
        take off: white - J d, d the `step` over the rows `known`."""
        j = held.whiten_stacked(self.columns)
        return white - j @ self.step(j, white, known) if np.all(np.isfinite(j)) else white

    def step(self, j: Array, white: Array, known: Array | None = None) -> Array:
        """d, (k,), least in |white - j d|^2 + |root d|^2, `j` (N, k) the whitened columns, over the rows
        `known`."""
        rows = slice(None) if known is None else known
        table = np.vstack([j[rows], self.root])
        right = np.append(white[rows], np.zeros(len(self.root)))
        scale = np.maximum(np.linalg.norm(table, axis=0), 1e-150)
        q, r = np.linalg.qr(table / scale)
        return np.linalg.lstsq(r, q.T @ right, rcond=1e-12)[0] / scale


def judged_by(held: Scene, fit: Fit) -> Scene:
    """`held` with the doubt that `fit` leaves."""
    return replace(held, doubt=Doubt.of(held, fit))
