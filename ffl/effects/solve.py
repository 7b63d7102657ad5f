"""Two solvers that force laws share: one for smooth forces, one for dry friction."""

from __future__ import annotations

from numba import njit

from ffl.effects.law import GV, GV_SLOPE, GX, GX_SLOPE, MEAN, SLOPE, STEP, V0, V1, X0, X1


@njit(error_model="numpy")
def end_motion(io, start_force, bulge):  # type: ignore[no-untyped-def]
    """(xa, gx, va, gv): the end of the step is xa + gx F1, va + gv F1 for a force that runs from
    `start_force` to F1 and whose mean lies `bulge` above the straight line."""
    xa = io[X1] + 0.5 * (io[GX] - io[GX_SLOPE]) * start_force + io[GX] * bulge
    va = io[V1] + 0.5 * (io[GV] - io[GV_SLOPE]) * start_force + io[GV] * bulge
    return xa, 0.5 * (io[GX] + io[GX_SLOPE]), va, 0.5 * (io[GV] + io[GV_SLOPE])


@njit(error_model="numpy")
def middle_motion(io, x1, v1):  # type: ignore[no-untyped-def]
    """Position and velocity half-way through the step: the cubic through both ends' motion."""
    rise = x1 - io[X0]
    x = 0.5 * (io[X0] + x1) + 0.125 * io[STEP] * (io[V0] - v1)
    return x, 1.5 * rise / io[STEP] - 0.25 * (io[V0] + v1)


@njit(error_model="numpy")
def bulge_of(start, middle, end):  # type: ignore[no-untyped-def]
    """How far the mean of the parabola through three values lies above the line (Simpson)."""
    return (2.0 * middle - start - end) / 3.0


@njit(error_model="numpy")
def set_curve(io, start, end, bulge):  # type: ignore[no-untyped-def]
    """The line with mean and first moment of a parabola from `start` to `end`."""
    io[MEAN] = 0.5 * (start + end) + bulge
    io[SLOPE] = 0.5 * (end - start)


@njit(error_model="numpy")
def set_line(io, start, end):  # type: ignore[no-untyped-def]
    """The straight line from one force to the other, for laws that need no more."""
    set_curve(io, start, end, 0.0)


@njit(error_model="numpy")
def set_friction(io, stuck, slide_plus, slide_minus, static_plus, static_minus):  # type: ignore[no-untyped-def]
    """Dry friction over one step: sliding, stopping, sticking, breaking away, reversing.

    `slide_plus/minus` = (level at the start, half-way, at the end) while sliding in + or - direction,
    `static_plus/minus` the levels that must be exceeded from rest. The velocity is taken to run
    straight between start, standstill and end, which is exact for a rigid mass:

    * at rest, the force that keeps the end at rest, if it is within the static levels;
    * sliding, -sign(v) level, as long as the end still moves the same way;
    * else the mass stops at the fraction tau of the step, and for the rest of it slides back, if the
      others push that way by more than its static level, or sticks (the force that balances them).

    Returns True where the end of the step is at rest.
    """
    v0, free, g, g_slope = io[V0], io[V1], io[GV], io[GV_SLOPE]
    direction = 0.0
    if not stuck:
        direction = 1.0 if v0 > 0 else (-1.0 if v0 < 0 else 0.0)
    else:
        v0 = 0.0
    if direction == 0.0:
        if free > g * static_plus:
            direction = 1.0
        elif free < -g * static_minus:
            direction = -1.0
        else:
            io[MEAN] = -free / g
            io[SLOPE] = 0.0
            return True
    start, middle, end = slide_plus if direction > 0 else slide_minus
    mean = -direction * (start + 4.0 * middle + end) / 6.0
    slope = -direction * 0.5 * (end - start)
    v1 = free + g * mean + g_slope * slope
    io[MEAN], io[SLOPE] = mean, slope
    if direction * v1 > 0 or v0 == 0.0:
        return False
    tau = min(max(v0 / (v0 - v1), 0.0), 1.0)
    before = -direction * start
    pull = (free - v0) / g  # mean of all other forces, in this friction's terms
    # Pushed on by a hair more than it is held, where levels change on the way, it has stopped all the same.
    if -pull <= static_minus if direction > 0 else pull <= static_plus:
        slope = 3.0 * tau * (1.0 - tau) * (-pull - before)
        io[SLOPE] = slope
        io[MEAN] = -(free + g_slope * slope) / g
        return True
    back, _, _ = slide_minus if direction > 0 else slide_plus
    after = direction * back
    io[MEAN] = tau * before + (1.0 - tau) * after
    io[SLOPE] = 3.0 * tau * (1.0 - tau) * (after - before)
    return False
