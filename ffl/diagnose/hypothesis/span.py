"""What columns span: orthonormal directions of it, and how far a model's own numbers go along them."""

from __future__ import annotations

import numpy as np

from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.triangle import lengths
from ffl.systems.state_space import Array

FREE = 1e6  # standard deviations of the noise that a number without a prior may do to y


def believed(j: Array, model: Model) -> tuple[Array, Array]:
    """Principal directions (N, p) of what the numbers of `model` may do to the whitened y as far as they
    are believed (`Coordinate.doubt`), from its Jacobian `j`; the share of each that they take off."""
    doubts = np.array([c.doubt for c in model.coordinates])
    size = np.maximum(np.linalg.norm(j, axis=0), 1e-150)
    spread = np.where(np.isfinite(doubts), doubts / np.sqrt(1.5), FREE / size)
    directions, strength, _ = np.linalg.svd(j * spread, full_matrices=False)
    return directions, 1.0 - 1.0 / np.sqrt(1.0 + strength**2)


def orthonormal(columns: Array) -> Array:
    """Basis of the columns' span; directions below 1e-9 of the largest are dropped."""
    if columns.shape[1] == 0:
        return np.zeros((len(columns), 0))
    size = np.maximum(lengths(columns), 1e-300)
    kept = columns[:, size > 1e-12 * size.max()] if size.max() > 1e-290 else columns[:, :0]
    if not kept.shape[1]:
        return kept
    u, s, _ = np.linalg.svd(kept / lengths(kept), full_matrices=False)
    return u[:, s > 1e-9 * s[0]]
