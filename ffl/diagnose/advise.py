"""Which experiment would tell the survivors apart."""

from __future__ import annotations

LADDER = "repeat the same move at a quarter, half and full amplitude"
EXPERIMENTS = {
    frozenset({"input_delay", "actuator_lag"}): "inject a multisine up to the Nyquist frequency: a "
    "delay turns the phase in proportion to frequency, a lag also lowers the gain",
    frozenset(
        {"asymmetric_friction", "constant_load"}
    ): "hold still at several forces, released from "
    "either side: a load shifts the standstill, friction does not",
    frozenset({"presliding_friction", "coulomb_friction"}): "drive with slow force ramps that stay "
    "below breakaway: presliding moves elastically, Coulomb friction does not move",
    frozenset(
        {"mass_change", "viscous_friction"}
    ): "move at constant speed and at high acceleration "
    "in turn: damping shows in the first, mass in the second",
}


def separate(name: str, other: str) -> str:
    """An experiment that separates two names, in a sentence."""
    known = EXPERIMENTS.get(frozenset({name, other}))
    if known:
        return f"{name} or {other}: {known}"
    return (
        f"{name} or {other}: {LADDER}, and with slow reversals; the two differ in how they grow with "
        "amplitude and speed"
    )
