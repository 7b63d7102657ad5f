"""Could anybody have told the effect from its rivals? A linearised oracle.

For each rival that does not contain the truth as a special case, several members of the rival are
put into the true machine. What the true effect's trace, whitened by the true noise, has outside the
cone of the members' traces and the span of the nominal parameters is twice the log-likelihood ratio
that an oracle has in hand. A cone and not a span: cubic springs about several centres span a linear
spring, but no sum of them with positive stiffness is one. The oracle knows the numbers of the effects
beside, and when what comes at random came: whoever has to find these can tell less.
"""

from __future__ import annotations

import numpy as np
import scipy.optimize

from ffl.challenge.build import Build, Scales
from ffl.challenge.detect import OWN_PARAMETER, Lens
from ffl.challenge.draw import Setup
from ffl.challenge.linear import Noise
from ffl.challenge.physics import EFFECTS
from ffl.challenge.stage import Part, assemble, whole_run

# The names that come closest, without those of which the truth is a special case.
RIVALS: dict[str, tuple[str, ...]] = {
    "coulomb_friction": ("viscous_friction", "hysteresis", "presliding_friction"),
    "asymmetric_friction": ("coulomb_friction", "constant_load"),
    "viscous_friction": ("coulomb_friction", "quadratic_drag", "input_delay"),
    "stribeck_friction": ("coulomb_friction", "presliding_friction"),
    "presliding_friction": ("coulomb_friction", "hysteresis", "stribeck_friction"),
    "position_dependent_friction": ("coulomb_friction", "asymmetric_friction"),
    "constant_load": ("drift", "asymmetric_friction"),
    "cogging": ("periodic_disturbance", "encoder_ripple"),
    "linear_stiffness": ("hardening_spring", "hysteresis"),
    "hardening_spring": ("linear_stiffness",),
    "position_dependent_gain": ("mass_change", "linear_stiffness"),
    "quadratic_drag": ("viscous_friction", "coulomb_friction"),
    "backlash": ("hysteresis", "presliding_friction", "coulomb_friction"),
    "hysteresis": ("presliding_friction", "coulomb_friction", "linear_stiffness"),
    "saturation": ("position_dependent_gain", "dead_zone"),
    "dead_zone": ("coulomb_friction", "presliding_friction"),
    "input_delay": ("actuator_lag", "viscous_friction"),
    "actuator_lag": ("input_delay", "viscous_friction"),
    "flexible_mode": ("actuator_lag", "mass_change"),
    "mass_change": ("viscous_friction", "position_dependent_gain"),
    "encoder_ripple": ("cogging",),
    "sensor_nonlinearity": ("saturation",),
    "periodic_disturbance": ("cogging",),
    "drift": ("constant_load",),
    # Outside the catalogue: the names of it that come closest.
    "eddy_brake": ("viscous_friction", "coulomb_friction"),
    "amplifier_asymmetry": ("position_dependent_gain", "saturation"),
    "hot_motor": ("drift", "position_dependent_gain"),
    "warm_guide": ("drift", "viscous_friction"),
    "magnet": ("cogging", "hardening_spring"),
    "end_stop": ("hardening_spring", "linear_stiffness"),
    "gain_ripple": ("cogging", "position_dependent_gain"),
    "load_dependent_friction": ("coulomb_friction", "viscous_friction"),
    "position_inertia": ("position_dependent_gain", "mass_change"),
    "creep": ("hysteresis", "presliding_friction"),
    "back_emf_limit": ("saturation", "viscous_friction"),
    "knocks": ("periodic_disturbance",),
    "lost_commands": ("input_delay", "actuator_lag"),
    "sensor_curvature": ("position_dependent_gain", "hardening_spring"),
}
MEMBERS = 6
SEPARABLE = 25.0  # an oracle's chi-square beyond doubt with up to MEMBERS free parameters


def rivals(
    setup: Setup, part: Part, parts: list[Part], scales: Scales, noise: Noise
) -> dict[str, float]:
    """Energy by which each rival misses the effect's trace; below SEPARABLE none can tell.

    Two points of attack (motor and load) count as one rival.
    """
    rest = [p for p in parts if p is not part]
    with_all, _ = assemble(setup, [*rest, part], scales)
    without, _ = assemble(setup, rest, scales)
    lens = Lens(setup)
    base = [whole_run(without, setup, e, None)[0] for e in setup.fit]

    def traces(build: Build) -> np.ndarray | None:
        quiet = Noise() if build.random else None
        moved = [
            whole_run(build, setup, e, quiet, np.random.default_rng([part.seed, j]))[0]
            for j, e in enumerate(setup.fit)
        ]
        if not all(np.all(np.isfinite(y)) for y in moved):
            return None
        return lens.whiten(noise, [a - b for a, b in zip(moved, base, strict=True)])

    truth = traces(with_all)
    assert truth is not None  # a case whose machine does not stay within its bounds is not written
    own = OWN_PARAMETER.get(part.name)
    nominal = [lens.whiten(noise, t) for key, t in lens.tangents.items() if key != own]
    basis = np.linalg.qr(np.array([c / np.linalg.norm(c) for c in nominal]).T)[0]

    def outside(x: np.ndarray) -> np.ndarray:
        return x - basis @ (basis.T @ x)

    rng = np.random.default_rng(part.seed + 1)
    points = ["motor", "load"] if setup.family.startswith("two_mass") else ["motor"]
    found = {}
    for name in RIVALS[part.name]:
        only = EFFECTS[name].machines
        if only and setup.family not in only:
            continue
        columns = []
        for k in range(MEMBERS):
            rival = Part(name, points[k % len(points)], int(rng.integers(2**31)), 0.6 + 0.2 * k)
            build, _ = assemble(setup, [*rest, rival], scales)
            column = traces(build)
            if column is not None and np.linalg.norm(column) > 0:
                columns.append(outside(column / np.linalg.norm(column)))
        if not columns:
            continue
        # The distance to a cone, in the coordinates of a QR of the few columns beside the truth.
        r = np.asarray(np.linalg.qr(np.array([*columns, outside(truth)]).T, mode="r"))
        found[name] = float(scipy.optimize.nnls(r[:, :-1], r[:, -1])[1] ** 2)
    return found
