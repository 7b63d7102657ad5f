"""Names of effects by what a first look may ask of them, and where."""

from __future__ import annotations

POSITIVE = (  # coefficients of the regressors are magnitudes
    "coulomb_friction",
    "asymmetric_friction",
    "viscous_friction",
    "stribeck_friction",
    "presliding_friction",
    "position_dependent_friction",
    "logarithmic_friction",
    "quadratic_drag",
    "backlash",
    "hysteresis",
    "dead_zone",
    "input_delay",
    "actuator_lag",
    "flexible_mode",
    "sensor_lead",
)

ABSOLUTE = frozenset(  # effects that need the position itself, not only changes of it
    {
        "cogging",
        "linear_stiffness",
        "hardening_spring",
        "preloaded_spring",
        "gravity_torque",
        "position_dependent_friction",
        "position_dependent_gain",
    }
)


AROUND = "cogging"  # which of them tells where each recording begins (`angles`)
BLIND = frozenset({"time", "temperature"})  # what a force depends on that feels no motion
LEADING = frozenset({"sensor_lead"})  # what the velocity of what is measured adds to it
# What a scale adds by its place, or holds back: a speed has none, and its integral begins anew every time.
OF_A_SCALE = frozenset({"encoder_ripple", "backlash"})
INERTIAL = frozenset({"flexible_mode", "mass_change", "preloaded_spring"})  # lags have no mass
