"""A point of a machine: where a force can act, and whose motion can be felt."""

from __future__ import annotations

from dataclasses import dataclass

from ffl.systems.state_space import Array


@dataclass(frozen=True)
class Point:
    """Force vector (state derivative per unit force) and rows that read position and velocity."""

    force: Array
    position: Array
    velocity: Array

    def minus(self, other: Point) -> Point:
        """The spring from this point to the other: a pair of forces, and the stretch between."""
        return Point(
            self.force - other.force,
            self.position - other.position,
            self.velocity - other.velocity,
        )

    def mapped(self, push: Array, pull: Array) -> Point:
        """The same point in other states: forces by `push`, rows by `pull`."""
        return Point(push @ self.force, self.position @ pull, self.velocity @ pull)

    @property
    def mobility(self) -> float:
        """Acceleration per unit force at this point (1/mass felt at high frequency)."""
        return float(self.velocity @ self.force)
