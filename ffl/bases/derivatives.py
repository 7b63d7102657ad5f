"""Derivatives of the reference: velocity, acceleration, jerk, snap."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ffl.bases.base import Basis
from ffl.errors import InputError
from ffl.systems.state_space import Array, ComplexArray

ORDERS = {"position": 0, "velocity": 1, "acceleration": 2, "jerk": 3, "snap": 4}


def derivative(reference: ArrayLike, order: int, sample_time: float) -> Array:
    """`order`-th derivative in unit/s^order by central differences, the ends held.

    delta = (q - q^-1)/(2T) for odd and (q - 2 + q^-1)/T^2 for each pair of orders, so that every
    derivative is centred on its sample.
    """
    value = np.asarray(reference, float)
    for _ in range(order // 2):
        padded = np.pad(value, 1, mode="edge")
        value = (padded[2:] - 2.0 * value + padded[:-2]) / sample_time**2
    if order % 2:
        padded = np.pad(value, 1, mode="edge")
        value = (padded[2:] - padded[:-2]) / (2.0 * sample_time)
    return value


class Derivatives(Basis):
    """f = sum of coefficients times derivatives of the reference; polynomial basis functions.

    `orders` names them: position, velocity, acceleration, jerk, snap. A coefficient carries the unit
    of f over that of the derivative (acceleration: the mass, where f is a force).
    """

    def __init__(
        self,
        orders: Sequence[str] = ("velocity", "acceleration", "jerk", "snap"),
        sample_time: float = 1.0,
    ) -> None:
        for name in orders:
            if name not in ORDERS:
                raise InputError(f"derivatives: order '{name}' unknown; known: {', '.join(ORDERS)}")
        if not orders or len(set(orders)) != len(orders):
            raise InputError(
                f"derivatives: orders = {list(orders)} must be different, at least one"
            )
        self.orders = list(orders)
        self.sample_time = float(sample_time)

    @property
    def names(self) -> list[str]:
        return list(self.orders)

    @property
    def preview(self) -> int:
        return max((ORDERS[name] + 1) // 2 for name in self.orders)

    def regressors(self, reference: ArrayLike) -> Array:
        return np.column_stack(
            [derivative(reference, ORDERS[name], self.sample_time) for name in self.orders]
        )

    def response(self, frequencies_hz: ArrayLike) -> ComplexArray:
        w = 2.0 * np.pi * np.atleast_1d(np.asarray(frequencies_hz, float)) * self.sample_time
        columns = []
        for name in self.orders:
            order = ORDERS[name]
            even = ((2.0 * np.cos(w) - 2.0) / self.sample_time**2) ** (order // 2)
            columns.append(even * (1j * np.sin(w) / self.sample_time) ** (order % 2))
        return np.column_stack(columns).astype(complex)
