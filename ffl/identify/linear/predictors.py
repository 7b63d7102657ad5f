"""From a model to what predicts y: simulation, simulation in the loop, one-step prediction.

A model is admissible where what it filters with is stable (spectral radius below 1 + slack).
Each predictor is one matrix M: (x+, y) = M (x, inputs), with the derivatives of M along the local
coordinates. Inputs end with a constant 1 where an offset is free.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ffl.identify.linear.coordinates import Point, Structure, Tangent
from ffl.identify.linear.signals import Scale, Signals
from ffl.systems import Controller
from ffl.systems.state_space import Array


class Predictor(Protocol):
    """What a fit needs: inputs and target per piece, the matrix, its derivatives, admissibility."""

    def inputs(self, piece: Signals) -> Array: ...

    def target(self, piece: Signals) -> Array: ...

    def matrix(self, point: Point) -> Array: ...

    def derivatives(self, point: Point, directions: Tangent) -> Array: ...

    def admissible(self, point: Point, slack: float = 0.0) -> bool: ...


def _with_constant(columns: list[Array], s: Structure) -> Array:
    if s.offset != "none":
        columns = [*columns, np.ones(columns[0].size)]
    return np.ascontiguousarray(np.column_stack(columns))


@dataclass(frozen=True)
class Innovation:
    """yhat = c x + d u, x+ = A x + b u + k (y - yhat): one-step prediction, any feedback allowed.

    Stable where A - k c is, whatever A is: a plant that integrates is predicted through its observer.
    """

    structure: Structure

    def inputs(self, piece: Signals) -> Array:
        nd = self.structure.delay
        return _with_constant([piece.force[: len(piece) - nd], piece.y[nd:]], self.structure)

    def target(self, piece: Signals) -> Array:
        return piece.y[self.structure.delay :]

    def matrix(self, point: Point) -> Array:
        n = point.a.shape[0]
        plant = point.matrix
        gain = np.append(point.k, 0.0)
        corrected = plant - np.outer(gain, plant[n])
        columns = [corrected, gain[:, None]]
        if self.structure.offset == "output":
            port = -gain
            port[n] = 1.0
            columns.append(point.offset * port[:, None])
        elif self.structure.offset == "input":
            columns.append(point.offset * corrected[:, n:])
        return np.hstack(columns)

    def derivatives(self, point: Point, directions: Tangent) -> Array:
        n, q = point.a.shape[0], directions.offset.size
        plant = point.matrix
        gain = np.append(point.k, 0.0)
        d_gain = np.vstack([directions.k, np.zeros(q)])
        d_corrected = (
            directions.matrix
            - gain[:, None, None] * directions.matrix[n][None]
            - d_gain[:, None, :] * plant[n][None, :, None]
        )
        parts = [d_corrected, d_gain[:, None, :]]
        if self.structure.offset == "output":
            port = -gain
            port[n] = 1.0
            d_port = -d_gain
            parts.append((point.offset * d_port + np.outer(port, directions.offset))[:, None, :])
        elif self.structure.offset == "input":
            corrected = plant - np.outer(gain, plant[n])
            parts.append(
                point.offset * d_corrected[:, n:]
                + corrected[:, n:, None] * directions.offset[None, None, :]
            )
        return np.concatenate(parts, axis=1)

    def admissible(self, point: Point, slack: float = 0.0) -> bool:
        poles = np.linalg.eigvals(point.a - np.outer(point.k, point.c))
        return bool(np.all(np.isfinite(poles)) and np.abs(poles).max(initial=0.0) < 1.0 + slack)


@dataclass(frozen=True)
class Simulation:
    """Free-running simulation, open loop or closed around a known controller.

    The plant Pi = [[A, b], [c, d]] sits in a fixed surrounding with states x_g and outputs (u_p, y)
    for inputs (known signals, w at the plant's input, v at its output, y_p): a linear fractional
    map, M = F0 + F1 Pi T with T = (I - E1 Pi)^-1 E0, dM = F1 (I - Pi E1)^-1 dPi T.
    """

    structure: Structure
    ag: Array
    bg: Array
    cg: Array
    dg: Array
    closed: bool

    @classmethod
    def open_loop(cls, structure: Structure) -> Simulation:
        # known signal u; columns (u, w, v, y_p)
        dg = np.array([[1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0]])
        return cls(
            structure, np.zeros((0, 0)), np.zeros((0, 4)), np.zeros((2, 0)), dg, closed=False
        )

    @classmethod
    def in_loop(cls, structure: Structure, controller: Controller, scale: Scale) -> Simulation:
        """Known signals (r, f, d); the controller and the delay line are the fixed states."""
        c = controller.state_space
        nc, nd = c.order, structure.delay
        b, d = c.b * scale.y, c.d * (scale.y / scale.u)
        cc = c.c / scale.u
        # command = cc xc + d_r r + f + d + w + d_y y; y = y_p + v
        command = np.concatenate([cc[0], np.zeros(nd)])
        by_input = np.array([d[0, 0], 1.0, 1.0, 1.0, d[0, 1], d[0, 1]])  # r f d w v y_p
        ag, bg = np.zeros((nc + nd, nc + nd)), np.zeros((nc + nd, 6))
        ag[:nc, :nc] = c.a
        bg[:nc, 0], bg[:nc, 4], bg[:nc, 5] = b[:, 0], b[:, 1], b[:, 1]
        cg, dg = np.zeros((2, nc + nd)), np.zeros((2, 6))
        dg[1, 4] = dg[1, 5] = 1.0
        if nd == 0:
            cg[0], dg[0] = command, by_input
        else:
            ag[nc] = command
            bg[nc] = by_input
            ag[nc + 1 :, nc : nc + nd - 1] = np.eye(nd - 1)
            cg[0, -1] = 1.0
        return cls(structure, ag, bg, cg, dg, closed=True)

    def inputs(self, piece: Signals) -> Array:
        if not self.closed:
            nd = self.structure.delay
            return _with_constant([piece.force[: len(piece) - nd]], self.structure)
        zero = np.zeros(len(piece))
        known = [zero if v is None else v for v in (piece.r, piece.f, piece.d)]
        return _with_constant(known, self.structure)

    def target(self, piece: Signals) -> Array:
        return piece.y if self.closed else piece.y[self.structure.delay :]

    def _surrounding(self, n: int) -> tuple[Array, Array, Array, Array]:
        ng, known = self.ag.shape[0], self.bg.shape[1] - 1
        e0 = np.zeros((n + 1, n + ng + known))
        e0[:n, :n] = np.eye(n)
        e0[n, n : n + ng], e0[n, n + ng :] = self.cg[0], self.dg[0, :-1]
        e1 = np.zeros((n + 1, n + 1))
        e1[n, n] = self.dg[0, -1]
        f0 = np.zeros((n + ng + 1, n + ng + known))
        f0[n : n + ng, n : n + ng], f0[n : n + ng, n + ng :] = self.ag, self.bg[:, :-1]
        f0[-1, n : n + ng], f0[-1, n + ng :] = self.cg[1], self.dg[1, :-1]
        f1 = np.zeros((n + ng + 1, n + 1))
        f1[:n, :n] = np.eye(n)
        f1[n : n + ng, n] = self.bg[:, -1]
        f1[-1, n] = self.dg[1, -1]
        return e0, e1, f0, f1

    @property
    def _port(self) -> int:
        return -2 if self.structure.offset == "input" else -1

    def matrix(self, point: Point) -> Array:
        plant = point.matrix
        e0, e1, f0, f1 = self._surrounding(point.a.shape[0])
        t = np.linalg.solve(np.eye(plant.shape[0]) - e1 @ plant, e0)
        whole = f0 + f1 @ plant @ t
        known = whole[:, :-2]
        if self.structure.offset == "none":
            return known
        return np.hstack([known, point.offset * whole[:, self._port][:, None]])

    def derivatives(self, point: Point, directions: Tangent) -> Array:
        plant = point.matrix
        size = plant.shape[0]
        e0, e1, f0, f1 = self._surrounding(size - 1)
        t = np.linalg.solve(np.eye(size) - e1 @ plant, e0)
        left = f1 @ np.linalg.inv(np.eye(size) - plant @ e1)
        d_whole = np.einsum("ij,jkq,kl->ilq", left, directions.matrix, t, optimize=True)
        known = d_whole[:, :-2]
        if self.structure.offset == "none":
            return known
        whole = f0 + f1 @ plant @ t
        column = point.offset * d_whole[:, self._port] + np.outer(
            whole[:, self._port], directions.offset
        )
        return np.concatenate([known, column[:, None, :]], axis=1)

    def admissible(self, point: Point, slack: float = 0.0) -> bool:
        m = self.structure.order - self.structure.integrators
        if self.closed:
            whole = self.matrix(point)
            n = whole.shape[0] - 1
            poles = np.linalg.eigvals(whole[:n, :n])
        else:
            poles = np.linalg.eigvals(point.a[:m, :m])
        return bool(np.all(np.isfinite(poles)) and np.abs(poles).max(initial=0.0) < 1.0 + slack)
