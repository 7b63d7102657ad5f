"""What the model makes of u laid beside y, and forces along the motion as measured."""

from __future__ import annotations

import numpy as np
import scipy.ndimage
import scipy.signal

from ffl.diagnose.recorded.holds import stands
from ffl.effects.modal import is_speed
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array
from ffl.systems.zpk import Zpk, as_state_space

STILL = 0.999  # a slower pole forgets too slowly to be compared below the corner
CORNER = 0.3  # of the mean frequency of u: where that begins
SPAN = 5  # samples over which the speed is read
WHILE = 21  # the same for standstill
AT_ZERO = 1e-9  # magnitude of a pole that only delays


def stated_delay(plant: Plant) -> int:
    """Samples by which the plant file says that u acts late: all that can be taken out of it."""
    system = plant.system
    own = system.delay if isinstance(system, Zpk) else 0
    return own + int(np.sum(np.abs(system.poles) < AT_ZERO))


def moved_by(plant: Plant, y: Array) -> list[Array]:
    """What drag, dry friction, dampers and springs depend on, along the motion as measured; a spring may
    push instead (a magnetic bearing)."""
    v = y if is_speed(plant.output_unit) else np.gradient(scipy.ndimage.uniform_filter1d(y, SPAN))
    x = y - np.mean(y)
    return [v * np.abs(v), np.sign(v), x**3, v, x, -x]


def held_by(plant: Plant, u: Array, y: Array) -> list[Array]:
    """What dry friction takes of u: all of it while y stands still, as its noise and rounding show it in
    what comes before and after, a level one way or the other where it moves."""
    if is_speed(plant.output_unit):
        return []
    sliding = scipy.ndimage.uniform_filter1d(np.gradient(y), WHILE)
    still = stands(y, WHILE)
    return [np.where(still, u, 0.0), np.where(still, 0.0, np.sign(sliding))]


def compared(
    plant: Plant, drive: Array, out: Array, by: Array | None = None
) -> tuple[Array, Array]:
    """G drive and `out`, less their means, once the start is forgotten; where G integrates above a corner,
    that of the drive `by`."""
    drive, out = drive - drive[0], out - out[0]
    led = drive if by is None else by
    power = np.abs(np.fft.rfft(led - led.mean())) ** 2
    cycles = float(power @ np.fft.rfftfreq(len(led))) / max(float(power.sum()), 1e-300)
    pole = np.exp(-2.0 * np.pi * CORNER * cycles)
    for _ in range(int(np.sum(np.abs(plant.system.poles) > STILL))):
        drive, out = (scipy.signal.lfilter([1.0, -1.0], [1.0, -pole], x) for x in (drive, out))
    made = np.atleast_1d(as_state_space(plant.system).filter(drive))
    made, out = made[len(made) // 10 :], out[len(out) // 10 :]
    return made - made.mean(), out - out.mean()


def factor_of(plant: Plant, drive: Array, out: Array) -> tuple[float, float]:
    """(k, share of `out`'s variance that is left) of out = k G drive + a constant."""
    made, out = compared(plant, drive, out)
    power, whole = float(made @ made), float(out @ out)
    if power <= 0.0 or whole <= 0.0:
        return 1.0, 1.0
    k = float(made @ out) / power
    return k, max(0.0, 1.0 - k * float(made @ out) / whole)
