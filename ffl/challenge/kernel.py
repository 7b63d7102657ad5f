"""The independent machine: continuous mechanics in small steps under a sampled controller.

    M q'' + D q' + K q = b (force of the actuator) + sum over elements p_k f_k

is integrated by drift-kick-drift (position Verlet; damping by the implicit midpoint), which is
exact for a rigid body under a held command and of second order otherwise. Dry friction is a
set-valued impulse solved at the end of each step (Moreau's time stepping): a body that sticks has
velocity exactly 0, and needs no regularised sign. Everything that makes one machine unlike another
is data in the arrays, so the function compiles once.

Rows of `elements`: code, port, parameters (see the constants). `ports[k]` maps q to the position
of point k and, transposed, a force at this point to generalised forces.
"""

import math

import numpy as np
from numba import njit

# Codes of the force elements and what their parameters (columns 2...) mean.
DRY = 1  # level_positive, level_negative, static_ratio, stribeck_velocity, table row, load share
SLIP = 2  # micro_damping, then (stiffness, yield displacement) of each Maxwell element
BOUC_WEN = 3  # force, displacement, exponent, beta
SPRING = 4  # linear, cubic, centre
DRAG = 5  # coefficient of v|v|
CONSTANT = 6  # force
SINE_OF_TIME = 7  # amplitude, frequency, phase
SINE_OF_POSITION = 8  # amplitude, period, phase, amplitude and phase of the second harmonic
GAP = 9  # gap, stiffness, damping: contact that pushes but never pulls
THERMAL = 10  # amplitude, time constant, heat per squared command (0: constant source), start
RELAXATION = 11  # stiffness, time constant: a spring whose force fades
BUMP = 12  # amplitude, centre, width
END_STOP = 13  # stiffness, where it begins, side
EDDY = 14  # coefficient, velocity of greatest force
INERTIA = 15  # mass amplitude, period, phase: inertia that depends on position

# Columns of the actuator's parameters.
DEAD, LIMIT, BACK_EMF, ASYMMETRY, GAIN_1, GAIN_2, GAIN_CENTRE = 0, 1, 2, 3, 4, 5, 6
RIPPLE, RIPPLE_PERIOD, RIPPLE_PHASE, FADE, FADE_TIME, FADE_HEAT, LAG, DELAY = range(7, 15)
N_ACTUATOR = 15

# Columns of the sensor's parameters.
OFFSET_SIN, OFFSET_COS, PITCH, CURVATURE, CLIP, RECTIFY, PLAY, RESOLUTION = range(8)
N_SENSOR = 8

N_COLUMNS = 26
N_STATES = 14


@njit(cache=True)
def _sections(sos, state, value):
    """One sample through biquads in transposed direct form II."""
    for k in range(sos.shape[0]):
        out = sos[k, 0] * value + state[k, 0]
        state[k, 0] = sos[k, 1] * value - sos[k, 4] * out + state[k, 1]
        state[k, 1] = sos[k, 2] * value - sos[k, 5] * out
        value = out
    return value


@njit(cache=True)
def _sense(sensor, position, play_state):
    """What the encoder electronics make of a position (before noise and quantisation)."""
    value = position
    if sensor[PLAY] > 0.0:
        value = play_state
    if sensor[PITCH] > 0.0:
        # Sine and cosine tracks with offsets, read by arctangent: the classical encoder error.
        angle = 2.0 * math.pi * value / sensor[PITCH]
        turn = math.atan2(
            math.sin(angle) + sensor[OFFSET_SIN], math.cos(angle) + sensor[OFFSET_COS]
        )
        error = turn - angle
        error -= 2.0 * math.pi * np.round(error / (2.0 * math.pi))
        value += error * sensor[PITCH] / (2.0 * math.pi)
    value += sensor[CURVATURE] * value * value
    if sensor[RECTIFY] > 0.0:
        value = abs(value)
    if sensor[CLIP] > 0.0:
        value = min(max(value, -sensor[CLIP]), sensor[CLIP])
    return value


@njit(cache=True)
def _level(row, tables, x, v, actuator_force, positive):
    """Dry friction level against positive (or negative) motion at position x and speed v."""
    level = row[2] if positive else row[3]
    table = int(row[6])
    if table >= 0:
        n = (tables.shape[1] - 2) // 2
        place = (x - tables[table, 0]) / (tables[table, 1] - tables[table, 0]) * (n - 1)
        place = min(max(place, 0.0), n - 1.000001)
        j = int(place)
        start = 2 if positive else 2 + n
        low, high = tables[table, start + j], tables[table, start + j + 1]
        level = low + (place - j) * (high - low)
    if row[5] > 0.0:
        level *= 1.0 + row[4] * math.exp(-((v / row[5]) ** 2))
    return level + row[7] * abs(actuator_force)


@njit(cache=True)
def _element_force(row, z, x, dx, v, t, h, command):
    """Force of one smooth element on its port; advances its state by one step."""
    code = int(row[0])
    if code == SLIP:
        # Damped is what gives way, not what slides: the mean deflection's rate.
        force, sticking, whole, j = 0.0, 0.0, 0.0, 0
        while j < N_STATES and row[3 + 2 * j] > 0.0:
            limit = row[4 + 2 * j]
            free = z[j] + dx
            z[j] = min(max(free, -limit), limit)
            whole += row[3 + 2 * j]
            if z[j] == free:
                sticking += row[3 + 2 * j]
            force -= row[3 + 2 * j] * z[j]
            j += 1
        return force - row[2] * v * sticking / whole
    if code == BOUC_WEN:
        step = dx / row[3]
        middle = z[0]
        for _ in range(2):  # implicit midpoint by two fixed-point sweeps
            sign = 1.0 if middle * step > 0.0 else (-1.0 if middle * step < 0.0 else 0.0)
            rate = 1.0 - abs(middle) ** row[4] * ((1.0 - row[5]) + row[5] * sign)
            middle = z[0] + 0.5 * step * rate
        z[0] += step * rate
        return -row[2] * z[0]
    if code == SPRING:
        return -row[2] * (x - row[4]) - row[3] * (x - row[4]) ** 3
    if code == DRAG:
        return -row[2] * v * abs(v)
    if code == CONSTANT:
        return row[2]
    if code == SINE_OF_TIME:
        return row[2] * math.sin(2.0 * math.pi * row[3] * t + row[4])
    if code == SINE_OF_POSITION:
        angle = 2.0 * math.pi * x / row[3]
        return row[2] * math.sin(angle + row[4]) + row[5] * math.sin(2.0 * angle + row[6])
    if code == GAP:
        if x > 0.5 * row[2]:
            return min(0.0, -row[3] * (x - 0.5 * row[2]) - row[4] * v)
        if x < -0.5 * row[2]:
            return max(0.0, -row[3] * (x + 0.5 * row[2]) - row[4] * v)
        return 0.0
    if code == THERMAL:
        heat = 1.0 if row[4] == 0.0 else row[4] * command * command
        if t < 0.0:
            heat = 0.0
        z[0] += (heat - z[0]) * (1.0 - math.exp(-h / row[3]))
        return row[2] * z[0]
    if code == RELAXATION:
        z[0] = z[0] * math.exp(-h / row[3]) + dx
        return -row[2] * z[0]
    if code == BUMP:
        return row[2] * math.exp(-(((x - row[3]) / row[4]) ** 2))
    if code == END_STOP:
        depth = row[4] * (x - row[3])
        return -row[4] * row[2] * depth if depth > 0.0 else 0.0
    if code == EDDY:
        return -row[2] * v / (1.0 + (v / row[3]) ** 2)
    return 0.0


@njit(cache=True)
def _amplifier(actuator, command, speed):
    """Static part of the amplifier: dead zone, asymmetry, limits."""
    out = command
    if actuator[DEAD] > 0.0:
        size = abs(out) - actuator[DEAD]
        out = 0.0 if size <= 0.0 else (size if out > 0.0 else -size)
    out *= 1.0 + (actuator[ASYMMETRY] if out > 0.0 else -actuator[ASYMMETRY])
    if actuator[LIMIT] > 0.0:
        limit = max(actuator[LIMIT] - actuator[BACK_EMF] * abs(speed), 0.0)
        out = min(max(out, -limit), limit)
    return out


@njit(cache=True)
def simulate(
    inverse,  # (n, n) (M + h D / 2)^-1
    keep,  # (n, n) inverse @ (M - h D / 2)
    stiffness,  # (n, n)
    motor,  # (n,) force of the actuator -> generalised forces
    gauge,  # (n,) positions -> measured position
    gauge_rate,  # (n,) velocities -> measured position
    constant,  # force per unit of the command
    ports,  # (n_ports, n)
    elements,  # (n_elements, N_COLUMNS)
    tables,  # (n_tables, 2 + 2 n_grid): x first, x last, levels positive, levels negative
    actuator,  # (N_ACTUATOR,)
    sensor,  # (N_SENSOR,)
    sos_reference,  # (n_sections, 6); empty: no controller
    sos_output,  # (n_sections, 6); empty: one-degree form, u_fb = C (r - y) with sos_reference
    reference,
    feedforward,
    sensor_noise,
    force_noise,  # input unit, held over a sample
    external,  # N, held over a sample, at port 0
    lost,  # nonzero: this sample's command does not arrive
    sample_time,
    steps,
    start,
):
    """Run the loop. Returns measured y, command u, and position and velocity of port 0 (true)."""
    n_samples, n = len(reference), len(motor)
    h = sample_time / steps
    q, v, half, smooth, pull = np.zeros((5, n))
    n_elements = elements.shape[0]
    state = np.zeros((n_elements, N_STATES))
    before = np.zeros(n_elements)
    impulse = np.zeros(n_elements)
    n_dry = 0
    for k in range(n_elements):
        if elements[k, 0] == DRY:
            n_dry += 1
        if elements[k, 0] == THERMAL:
            state[k, 0] = elements[k, 5] * (1.0 - math.exp(-max(start, 0.0) / elements[k, 3]))
    filter_r = np.zeros((max(sos_reference.shape[0], 1), 2))
    filter_y = np.zeros((max(sos_output.shape[0], 1), 2))
    delay = int(actuator[DELAY])
    ring = np.zeros(delay + 1)
    head = 0
    lagged = 0.0
    heat = 0.0
    held = 0.0
    play = 0.0
    lag_factor = 1.0 - math.exp(-h / actuator[LAG]) if actuator[LAG] > 0.0 else 1.0
    fade_factor = 1.0 - math.exp(-h / actuator[FADE_TIME]) if actuator[FADE] > 0.0 else 0.0
    y, u, x_port, v_port = np.zeros((4, n_samples))
    for i in range(n_samples):
        position = 0.0
        for a in range(n):
            position += gauge[a] * q[a] + gauge_rate[a] * v[a]
            x_port[i] += ports[0, a] * q[a]
            v_port[i] += ports[0, a] * v[a]
        measured = _sense(sensor, position, play) + sensor_noise[i]
        if sensor[RESOLUTION] > 0.0:
            measured = np.round(measured / sensor[RESOLUTION]) * sensor[RESOLUTION]
        y[i] = measured
        command = feedforward[i]
        if sos_output.shape[0] > 0:
            command += _sections(sos_reference, filter_r, reference[i])
            command -= _sections(sos_output, filter_y, measured)
        elif sos_reference.shape[0] > 0:
            command += _sections(sos_reference, filter_r, reference[i] - measured)
        u[i] = command
        if lost[i] == 0:
            held = command
        for s in range(steps):
            t = start + (i + (s + 0.5) / steps) * sample_time
            speed = 0.0
            place = 0.0
            for a in range(n):
                half[a] = q[a] + 0.5 * h * v[a]
                speed += motor[a] * v[a]
                place += motor[a] * half[a]
            amplified = _amplifier(actuator, held, speed)
            ring[head] = amplified
            head = (head + 1) % (delay + 1)
            amplified = ring[head]  # the oldest entry: `delay` steps ago
            if actuator[LAG] > 0.0:
                # Mean over the step of the exponential answer to a constant input.
                late = lagged + (amplified - lagged) * lag_factor
                mean = amplified + (late - lagged) * (-actuator[LAG] / h)
                lagged = late
                amplified = mean
            drive = amplified + force_noise[i]
            offset = place - actuator[GAIN_CENTRE]
            gain = 1.0 + actuator[GAIN_1] * offset + actuator[GAIN_2] * offset * offset
            if actuator[RIPPLE] != 0.0:
                gain += actuator[RIPPLE] * math.sin(
                    2.0 * math.pi * place / actuator[RIPPLE_PERIOD] + actuator[RIPPLE_PHASE]
                )
            if actuator[FADE] > 0.0:
                heat += (actuator[FADE_HEAT] * amplified * amplified - heat) * fade_factor
                gain *= 1.0 - actuator[FADE] * heat
            force = constant * drive * gain
            for a in range(n):
                pull[a] = motor[a] * force + ports[0, a] * external[i]
                for c in range(n):
                    pull[a] -= stiffness[a, c] * half[c]
            swing = -1
            for k in range(n_elements):
                code = int(elements[k, 0])
                if code == DRY:
                    continue
                if code == INERTIA:
                    swing = k
                    continue
                port = int(elements[k, 1])
                x = 0.0
                w = 0.0
                for a in range(n):
                    x += ports[port, a] * half[a]
                    w += ports[port, a] * v[a]
                f = _element_force(elements[k], state[k], x, x - before[k], w, t, h, held)
                before[k] = x
                for a in range(n):
                    pull[a] += ports[port, a] * f
            if swing >= 0:
                port = int(elements[swing, 1])
                x = 0.0
                w = 0.0
                for a in range(n):
                    x += ports[port, a] * half[a]
                    w += ports[port, a] * v[a]
                wave = 2.0 * math.pi / elements[swing, 3]
                slope = elements[swing, 2] * wave * math.cos(wave * x + elements[swing, 4])
                for a in range(n):
                    pull[a] -= ports[port, a] * 0.5 * slope * w * w
            for a in range(n):
                smooth[a] = 0.0
                for c in range(n):
                    smooth[a] += keep[a, c] * v[c] + h * inverse[a, c] * pull[c]
            if swing >= 0:
                # (M + m p p') dv = known, by the Sherman-Morrison formula.
                port = int(elements[swing, 1])
                extra = elements[swing, 2] * math.sin(wave * x + elements[swing, 4])
                rate = 0.0
                own = 0.0
                for a in range(n):
                    rate += ports[port, a] * (smooth[a] - v[a])
                    for c in range(n):
                        own += ports[port, a] * inverse[a, c] * ports[port, c]
                for a in range(n):
                    for c in range(n):
                        smooth[a] -= (
                            inverse[a, c] * ports[port, c] * extra * rate / (1.0 + extra * own)
                        )
            if n_dry > 0:
                for k in range(n_elements):
                    impulse[k] = 0.0
                for _ in range(1 if n_dry == 1 else 8):
                    for k in range(n_elements):
                        if elements[k, 0] != DRY:
                            continue
                        port = int(elements[k, 1])
                        own = 0.0
                        w = 0.0
                        x = 0.0
                        w_old = 0.0
                        for a in range(n):
                            w += ports[port, a] * smooth[a]
                            w_old += ports[port, a] * v[a]
                            x += ports[port, a] * half[a]
                            for c in range(n):
                                own += ports[port, a] * inverse[a, c] * ports[port, c]
                        up = h * _level(elements[k], tables, x, w_old, force, True)
                        down = h * _level(elements[k], tables, x, w_old, force, False)
                        new = min(max(impulse[k] - w / own, -up), down)
                        change = new - impulse[k]
                        impulse[k] = new
                        for a in range(n):
                            for c in range(n):
                                smooth[a] += inverse[a, c] * ports[port, c] * change
            true = 0.0
            for a in range(n):
                v[a] = smooth[a]
                q[a] = half[a] + 0.5 * h * v[a]
                true += gauge[a] * q[a] + gauge_rate[a] * v[a]
            if sensor[PLAY] > 0.0:
                play = min(max(play, true - 0.5 * sensor[PLAY]), true + 0.5 * sensor[PLAY])
    return y, u, x_port, v_port
