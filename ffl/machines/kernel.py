"""The one compiled closed-loop kernel: linear plant, controller, any set of effects."""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

from ffl.effects.law import (
    COMMIT,
    FIRST,
    GV,
    GV_SLOPE,
    GX,
    GX_SLOPE,
    IO_SIZE,
    MEAN,
    SENT,
    SLOPE,
    STEP,
    TIME,
    V0,
    V1,
    X0,
    X1,
)

COMMAND, FORCE, OUTPUT = 0, 1, 2
PORTS = {"command": COMMAND, "force": FORCE, "output": OUTPUT, "flow": FORCE}
SWEEPS = 20
TOLERANCE = 1e-9  # of the largest force: error at which coupled effects are solved
DIVERGED = 1e150


def _call_law(typingctx, address, p, at_p, s, at_s, io):  # type: ignore[no-untyped-def]
    """Calls the law at `address` with pointers to p[at_p], s[at_s] and io."""
    signature = types.void(types.int64, p, types.int64, s, types.int64, io)

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        pointer = ir.DoubleType().as_pointer()
        law = builder.inttoptr(args[0], ir.FunctionType(ir.VoidType(), [pointer] * 3).as_pointer())

        def data(index):  # type: ignore[no-untyped-def]
            array = cgutils.create_struct_proxy(signature.args[index])
            return array(context, builder, value=args[index]).data

        arguments = [builder.gep(data(1), [args[2]]), builder.gep(data(3), [args[4]]), data(5)]
        builder.call(law, arguments)
        return context.get_dummy_value()

    return signature, codegen


call_law: Any = intrinsic(_call_law)


@njit(cache=True, nogil=True, error_model="numpy")
def run_loop(signals, plant, points, controller, sensor, effects, state, out):  # type: ignore[no-untyped-def]
    """Runs the loop over all samples; the last state is left in `state`.

    signals, each (N,): reference, feedforward, force beside the command, sensor noise, force at the last
    point (straight between samples; none where it has length 0). Sample by sample:
    y = sensor(C x + D u + noise) rounded to the encoder, u = clip(C_r r - C_y y + f), and over the
    `substeps` of the sample the command effects, the free response of the linear part, and the
    forces of all effects, solved together by Gauss-Seidel sweeps (each law solves for its own force
    with the others' held).
    """
    reference, feedforward, disturbance, noise, applied = signals
    a, b, b_slope, c, feedthrough, bias, fast_a, fast_b, fast_c, delay, h, substeps, t0 = plant
    rows_x, rows_v, e, e_slope, gx, gv, gx_slope, gv_slope = points
    ca, cb, cc, cd = controller
    resolution, limit = sensor
    addresses, ports, where, remembers, at_p, at_s, p, s = effects
    x, xf, ring, xc = state
    y_out, u_out, x_out, v_out, contribution = out
    samples, n, nf, m, count = len(reference), len(x), len(xf), len(xc), len(addresses)
    n_points = len(rows_x)
    following, fast_following, xc_following = np.empty(n), np.empty(nf), np.empty(m)
    io = np.zeros(IO_SIZE)
    io[STEP] = h
    mean, slope = np.zeros(count), np.zeros(count)
    x0, v0, x1, v1 = np.zeros(n_points), np.zeros(n_points), np.zeros(n_points), np.zeros(n_points)
    forces = 0
    for j in range(count):
        if ports[j] == FORCE:
            forces += 1
    for w in range(n_points):
        for i in range(n):
            x0[w] += rows_x[w, i] * x[i]
            v0[w] += rows_v[w, i] * x[i]
    closes = 1.0 / (1.0 - cd[0, 1] * feedthrough) if delay == 0 else 1.0
    for k in range(samples):
        time = t0 + k * h * substeps
        # --- measure and control -----------------------------------------------------------------
        y = 0.0
        for i in range(n):
            y += c[i] * x[i]
        for i in range(nf):
            y += fast_c[i] * xf[i]
        u = feedforward[k] + cd[0, 0] * reference[k]
        for i in range(m):
            u += cc[0, i] * xc[i]
        if feedthrough != 0.0:
            through = ring[k % delay] if delay > 0 else 0.0
            y += feedthrough * (disturbance[k] + through)
            if delay == 0:
                y += feedthrough * closes * (u + cd[0, 1] * (y + noise[k]))
        y += noise[k]
        for j in range(count):
            if ports[j] == OUTPUT:
                io[TIME], io[MEAN] = time, y
                io[X0], io[V0] = x0[where[j]], v0[where[j]]
                call_law(addresses[j], p, at_p[j], s, at_s[j], io)
                contribution[k, j] = io[MEAN] - y
                y = io[MEAN]
        if resolution > 0.0:
            y = resolution * np.round(y / resolution)
        u += cd[0, 1] * y
        if u > limit:
            u = limit
        elif u < -limit:
            u = -limit
        y_out[k], u_out[k] = y, u
        for i in range(m):
            value = cb[i, 0] * reference[k] + cb[i, 1] * y
            for q in range(m):
                value += ca[i, q] * xc[q]
            xc_following[i] = value
        for i in range(m):
            xc[i] = xc_following[i]
        if delay > 0:
            u, ring[k % delay] = ring[k % delay], u
        # --- move --------------------------------------------------------------------------------
        for w in range(n_points):
            x_out[k, w], v_out[k, w] = x0[w], v0[w]
        driven = 0.0
        for sub in range(substeps):
            io[TIME] = time + sub * h
            um, us = u, 0.0
            for j in range(count):
                if ports[j] == COMMAND:
                    io[X0], io[V0], io[MEAN], io[SLOPE] = x0[where[j]], v0[where[j]], um, us
                    call_law(addresses[j], p, at_p[j], s, at_s[j], io)
                    contribution[k, j] += (io[MEAN] - um) / substeps
                    um, us = io[MEAN], io[SLOPE]
            io[SENT] = um
            um += disturbance[k]
            driven += um / substeps
            for i in range(n):
                value = b[i] * um + b_slope[i] * us + bias[i]
                for q in range(n):
                    value += a[i, q] * x[q]
                following[i] = value
            if len(applied) > 0:
                rise = (applied[min(k + 1, samples - 1)] - applied[k]) / substeps
                push = applied[k] + (sub + 0.5) * rise
                for i in range(n):
                    following[i] += (
                        e[i, n_points - 1] * push + e_slope[i, n_points - 1] * 0.5 * rise
                    )
            for w in range(n_points):
                x1[w], v1[w] = 0.0, 0.0
                for i in range(n):
                    x1[w] += rows_x[w, i] * following[i]
                    v1[w] += rows_v[w, i] * following[i]
            if forces > 0:
                for j in range(count):
                    if ports[j] == FORCE:
                        for w in range(n_points):
                            x1[w] += gx[w, where[j]] * mean[j] + gx_slope[w, where[j]] * slope[j]
                            v1[w] += gv[w, where[j]] * mean[j] + gv_slope[w, where[j]] * slope[j]
                before, idle = 0.0, 0
                for sweep in range(SWEEPS):
                    change, size = 0.0, 0.0
                    io[FIRST] = 1.0 if sweep == 0 else 0.0
                    for j in range(count):
                        # Solved already, if none of the others has changed since.
                        if ports[j] != FORCE or (sweep > 0 and idle >= forces - 1):
                            continue
                        w = where[j]
                        io[X0], io[V0] = x0[w], v0[w]
                        io[GX], io[GV] = gx[w, w], gv[w, w]
                        io[GX_SLOPE], io[GV_SLOPE] = gx_slope[w, w], gv_slope[w, w]
                        io[MEAN], io[SLOPE] = mean[j], slope[j]
                        io[X1] = x1[w] - gx[w, w] * mean[j] - gx_slope[w, w] * slope[j]
                        io[V1] = v1[w] - gv[w, w] * mean[j] - gv_slope[w, w] * slope[j]
                        call_law(addresses[j], p, at_p[j], s, at_s[j], io)
                        dm, ds = io[MEAN] - mean[j], io[SLOPE] - slope[j]
                        mean[j], slope[j] = io[MEAN], io[SLOPE]
                        idle = idle + 1 if dm == 0.0 and ds == 0.0 else 0
                        for q in range(n_points):
                            x1[q] += gx[q, w] * dm + gx_slope[q, w] * ds
                            v1[q] += gv[q, w] * dm + gv_slope[q, w] * ds
                        change = max(change, abs(dm), abs(ds))
                        size = max(size, abs(mean[j]))
                    # Sweeps contract; what the next would change is foretold from the last two.
                    if forces == 1 or change <= TOLERANCE * size:
                        break
                    if change <= 0.1 * before and change * change <= TOLERANCE * size * before:
                        break
                    before = change
                io[COMMIT] = 1.0
                for j in range(count):
                    if ports[j] == FORCE:
                        w = where[j]
                        if remembers[j]:
                            io[X0], io[V0], io[X1], io[V1] = x0[w], v0[w], x1[w], v1[w]
                            io[MEAN], io[SLOPE] = mean[j], slope[j]
                            call_law(addresses[j], p, at_p[j], s, at_s[j], io)
                        contribution[k, j] += mean[j] / substeps
                        for i in range(n):
                            following[i] += e[i, w] * mean[j] + e_slope[i, w] * slope[j]
                io[COMMIT] = 0.0
            for i in range(n):
                x[i] = following[i]
            for w in range(n_points):
                x0[w], v0[w] = x1[w], v1[w]
        for i in range(nf):
            value = fast_b[i] * driven
            for q in range(nf):
                value += fast_a[i, q] * xf[q]
            fast_following[i] = value
        for i in range(nf):
            xf[i] = fast_following[i]
        if not abs(y) < DIVERGED:
            for q in range(k, samples):
                y_out[q], u_out[q], x_out[q], v_out[q] = np.nan, np.nan, np.nan, np.nan
            break
