"""The mass that a plant file states, held against the one that the plant moves."""

from __future__ import annotations

from ffl.effects.modal import force_unit, is_speed, mechanics_of
from ffl.systems import Plant

OFF = 1.5  # factor between the two beyond which one of them is wrong
FREE = 1e-3  # of the second mode's pulsation: a first mode slower than that is a body that moves freely


def mass_said(plant: Plant) -> str:
    """A sentence where `physics.mass` m and the plant's moving mass k / residue, k the motor constant,
    differ by more than a factor of `OFF`; empty where they agree or nothing tells.

    The residue is that of the first mode where that is a free body, which is all that moves wherever force
    and sensor are, or the only one. Unit: force s^2 / output unit.
    """
    stated, constant = plant.physics.mass, plant.physics.motor_constant
    if stated is None or constant is None:
        return ""
    mechanics = mechanics_of(plant.system, is_speed(plant.output_unit))
    modes = mechanics.modes
    if not modes or (
        len(modes) > 1 and abs(modes[0].stiffness) > FREE**2 * abs(modes[1].stiffness)
    ):
        return ""
    moved = mechanics.moving_mass * constant
    if 1.0 / OFF < stated / moved < OFF:
        return ""
    length = plant.output_unit.split("/")[0] or "output unit"
    return (
        f"physics.mass = {stated:.4g}, but by its gain and physics.motor_constant = {constant:.4g} the "
        f"plant moves {moved:.4g} {force_unit(plant)} s^2/{length}; mend the mass (in that unit), the "
        "motor constant or the gain"
    )
