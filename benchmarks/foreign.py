"""Recordings from other fields, as their owners have them: does the whole way work and what does it say?

Each is simulated here by small Runge-Kutta or Euler steps (nothing of ffl's machines or effects), written
in a format of its field with names and units of its own, read through a small map, given a linear model
by `ffl identify linear` (the last three state one by hand) and diagnosed by `ffl diagnose`, all through the
command line.

    python benchmarks/foreign.py [NAME...] [--seed 1] [--keep DIR] [--json]
    python benchmarks/foreign.py --keep DIR --picture reports/other_fields.png
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import h5py
import numpy as np
from _stated import arm, spindle, tank
from numba import njit
from scipy import io, signal

FINE = 20  # small steps per sample


@dataclass(frozen=True)
class Field:
    """`write(folder, rng)` leaves data.map.toml and the recordings; `wanted`: names that are right, with
    the numbers that must be met (parameter, value, relative tolerance); `unnamed` may be right as well."""

    name: str
    about: str
    write: Callable[[Path, np.random.Generator], tuple[str, str]]
    wanted: dict[str, dict[str, float]]
    may_be_unnamed: bool = False
    also: tuple[str, ...] = ()  # names that are there as well, of which one may be found or not


def multisine(n, rate, low, high, rms, rng):  # type: ignore[no-untyped-def]
    """One period of random phases, every line from `low` to `high` Hz."""
    lines = np.arange(n // 2 + 1) * rate / n
    spectrum = np.where((lines >= low) & (lines <= high), 1.0, 0.0)
    wave = np.fft.irfft(spectrum * np.exp(2j * np.pi * rng.random(len(lines))), n)
    return rms * wave / np.std(wave)


def staircase(n, hold, low, high, rng):  # type: ignore[no-untyped-def]
    """Levels at random, each held for 0.5 to 1.5 times `hold` samples."""
    out = np.zeros(n)
    at = 0
    while at < n:
        stop = at + round(hold * rng.uniform(0.5, 1.5))
        out[at:stop] = rng.uniform(low, high)
        at = stop
    return out


# Mechanical vibration: Bouc-Wen benchmark (nonlinearbenchmark.org), its published numbers.
@njit
def _bouc_wen(force, h, per):  # type: ignore[no-untyped-def]
    m, c, k = 2.0, 10.0, 5e4
    alpha, beta, gamma, delta = 5e4, 1e3, 0.8, -1.1
    out = np.zeros(len(force) // per)
    x, v, z = 0.0, 0.0, 0.0
    s, d = np.zeros(3), np.zeros((4, 3))
    for i in range(len(force)):
        if i % per == 0:
            out[i // per] = x
        for stage in range(4):
            part = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
            s[0], s[1], s[2] = x, v, z
            if stage > 0:
                s += part * d[stage - 1]
            d[stage, 0] = s[1]
            d[stage, 1] = (force[i] - c * s[1] - k * s[0] - s[2]) / m
            d[stage, 2] = alpha * s[1] - beta * (
                gamma * abs(s[1]) * s[2] + delta * s[1] * abs(s[2])
            )
        x += h * (d[0, 0] + 2 * d[1, 0] + 2 * d[2, 0] + d[3, 0]) / 6
        v += h * (d[0, 1] + 2 * d[1, 1] + 2 * d[2, 1] + d[3, 1]) / 6
        z += h * (d[0, 2] + 2 * d[1, 2] + 2 * d[2, 2] + d[3, 2]) / 6
    return out


def bouc_wen(folder, rng):  # type: ignore[no-untyped-def]
    rate, n = 750.0, 24576
    fine = np.fft.irfft(np.fft.rfft(multisine(n, rate, 5, 150, 50.0, rng)), n * FINE) * FINE
    t = np.arange(round(30 * rate) * FINE) / (rate * FINE)
    sweep = 40.0 * np.sin(2 * np.pi * (20.0 * t + 0.5 * t**2))
    for name, force in (("multisine", fine), ("sweep", sweep)):
        y = _bouc_wen(force, 1 / (rate * FINE), FINE)
        y = y + 8e-6 * rng.standard_normal(len(y))
        io.savemat(
            folder / f"BoucWen_{name}.mat", {"F": force[::FINE], "disp": 1e3 * y, "fs": rate}
        )
    (folder / "data.map.toml").write_text(
        'sample_time = 0.0013333333333333333\n[columns]\nu = { name = "F", unit = "N" }\n'
        'y = { name = "disp", scale = 1e-3, unit = "m" }\n'
    )
    return "BoucWen_multisine.mat", "BoucWen_sweep.mat"


# Drives: a brushed motor on a test bench, volts in, tachometer out.
@njit
def _motor(volts, h, per, limit, dry):  # type: ignore[no-untyped-def]
    inertia, r, k, viscous, inductance = 1.2e-4, 0.9, 0.055, 2e-5, 0.8e-3
    out = np.zeros(len(volts))
    w, i = 0.0, 0.0
    for n in range(len(volts)):
        out[n] = w
        v = min(max(volts[n], -limit), limit)
        for _ in range(per):
            i += h * (v - r * i - k * w) / inductance
            free = w + h * (k * i - viscous * w) / inertia
            stop = h * dry / inertia
            w = free - stop if free > stop else (free + stop if free < -stop else 0.0)
    return out


def dc_motor(folder, rng):  # type: ignore[no-untyped-def]
    rate = 200.0
    for name, n in (("Lauf1", 8000), ("Lauf2", 5000)):
        volts = np.round(staircase(n, 60, -24.0, 24.0, rng), 2)
        w = _motor(volts, 1 / rate / 100, 100, 17.0, 0.03)
        rpm = np.round(w * 30 / np.pi + 2.0 * rng.standard_normal(n), 1)
        lines = [
            "Prüfstand 3;Antrieb A",
            "Datum;12.03.2024",
            "",
            "Zeit;Spannung;Drehzahl",
            "ms;V;1/min",
        ]
        lines += [
            f"{1e3 * k / rate:.1f};{a:.2f};{b:.1f}"
            for k, (a, b) in enumerate(zip(volts, rpm, strict=True))
        ]
        text = "\r\n".join(lines[:5]) + "\r\n" + "\r\n".join(lines[5:]).replace(".", ",") + "\r\n"
        (folder / f"{name}.csv").write_bytes(text.encode("latin-1"))
    (folder / "data.map.toml").write_text(
        '[columns]\nt = { name = "Zeit", scale = 1e-3 }\nu = "Spannung"\ny = "Drehzahl"\n'
    )
    return "Lauf1.csv", "Lauf2.csv"


# Process: a flow of warm water through a valve that sticks, logged every ten seconds with dates.
@njit
def _sticky(command, h, per, band):  # type: ignore[no-untyped-def]
    out = np.zeros(len(command))
    stem, flow, level = command[0], 0.0, 0.0
    flow = 0.6 * stem
    level = flow
    for n in range(len(command)):
        out[n] = level
        if abs(command[n] - stem) > band:
            stem = command[n]
        for _ in range(per):
            flow += h * (0.6 * stem - flow) / 25.0
            level += h * (flow - level) / 70.0
    return out


def stamps(n, every):  # type: ignore[no-untyped-def]
    start = np.datetime64("2024-05-06T08:00:00")
    return [str(start + np.timedelta64(every * k, "s")).replace("T", " ") for k in range(n)]


def sticky_valve(folder, rng):  # type: ignore[no-untyped-def]
    for name, n in (("mai06", 3000), ("mai07", 2000)):
        wave = np.cumsum(rng.standard_normal(n)) * 0.8
        slow = signal.sosfiltfilt(signal.butter(2, 0.03, output="sos"), wave)
        command = np.round(50 + 25 * (slow - slow.mean()) / np.abs(slow - slow.mean()).max(), 2)
        flow = np.round(_sticky(command, 1.0, 10, 3.0) + 0.05 * rng.standard_normal(n), 2)
        with (folder / f"{name}.tsv").open("w") as file:
            file.write("Timestamp\tFIC101.OUT [%]\tFIC101.PV [m3/h]\n")
            for stamp, a, b in zip(stamps(n, 10), command, flow, strict=True):
                file.write(f"{stamp}\t{a}\t{b}\n")
    (folder / "data.map.toml").write_text(
        '[columns]\nt = "Timestamp"\nu = "FIC101.OUT"\ny = "FIC101.PV"\n'
    )
    return "mai06.tsv", "mai07.tsv"


# Process: heated room whose sensor ends at 45 degC.
def room(folder, rng):  # type: ignore[no-untyped-def]
    for name, n in (("week1", 4000), ("week2", 2500)):
        power = np.round(staircase(n, 25, 0.0, 70.0, rng))
        wall, air, y = 30.0, 33.0, np.zeros(n)
        for k in range(n):
            y[k] = air
            for _ in range(20):
                air += 3.0 * ((0.03 * power[k]) - 0.08 * (air - wall) - 0.02 * (air - 18)) / 60
                wall += 3.0 * (0.05 * (air - wall) - 0.03 * (wall - 18)) / 900
        y = np.minimum(np.round(y + 0.05 * rng.standard_normal(n), 2), 45.0)
        with (folder / f"{name}.csv").open("w") as file:
            file.write("# building 7\nminutes,heater_pct,T_room_degC\n")
            file.writelines(
                f"{k},{a:g},{b:g}\n" for k, (a, b) in enumerate(zip(power, y, strict=True))
            )
    (folder / "data.map.toml").write_text(
        '[columns]\nt = { name = "minutes", scale = 60 }\nu = { name = "heater_pct", unit = "%" }\n'
        'y = { name = "T_room_degC", unit = "degC" }\n'
    )
    return "week1.csv", "week2.csv"


# Microsystems: a stage on silicon springs, 100 kHz, micrometres.
@njit
def _duffing(volts, h, per):  # type: ignore[no-untyped-def]
    w0, q, gain, cubic = 2 * np.pi * 3200.0, 25.0, 0.45, 0.012
    out = np.zeros(len(volts))
    x, v = 0.0, 0.0
    for n in range(len(volts)):
        out[n] = x
        for _ in range(per):
            a = w0**2 * (gain * volts[n] - x - cubic * x**3) - w0 / q * v
            v += h * a
            x += h * v
    return out


def mems(folder, rng):  # type: ignore[no-untyped-def]
    rate = 100e3
    with h5py.File(folder / "stage.h5", "w") as file:
        for name, n in (("noise_1", 30000), ("noise_2", 20000)):
            volts = multisine(n, rate, 50, 8000, 0.7, rng)
            x = _duffing(volts, 1 / rate / 200, 200) + 0.003 * rng.standard_normal(n)
            group = file.create_group(name)
            group["sample"] = np.arange(n)
            group["drive"], group["disp"] = volts, x
            group["drive"].attrs["unit"], group["disp"].attrs["unit"] = "V", "um"
    (folder / "data.map.toml").write_text(
        '[[recordings]]\nname = "noise_1"\n[recordings.columns]\n'
        't = { name = "noise_1.sample", scale = 1e-5 }\nu = "noise_1.drive"\ny = "noise_1.disp"\n'
        '[[recordings]]\nname = "noise_2"\n[recordings.columns]\n'
        't = { name = "noise_2.sample", scale = 1e-5 }\nu = "noise_2.drive"\ny = "noise_2.disp"\n'
    )
    return "stage.h5::noise_1", "stage.h5::noise_2"


# Ships: thrust in, speed over ground in knots, drag with the square of the speed.
def ship(folder, rng):  # type: ignore[no-untyped-def]
    for name, n in (("trial_a", 3600), ("trial_b", 2400)):
        thrust = np.round(staircase(n, 150, 5.0, 95.0, rng), 1)
        v, y = 1.0, np.zeros(n)
        for k in range(n):
            y[k] = v
            for _ in range(10):
                v += 0.1 * (1e3 * thrust[k] - 1500.0 * v - 2400.0 * v * abs(v)) / 4.2e5
        y = np.round(y / 0.514444 + 0.02 * rng.standard_normal(n), 2)
        rows = np.column_stack([np.arange(n), thrust, y])
        np.savetxt(
            folder / f"{name}.txt", rows, fmt="%g", header="Time(s) Thrust(kN) SOG(kn)", comments=""
        )
    (folder / "data.map.toml").write_text('[columns]\nt = "Time"\nu = "Thrust"\ny = "SOG"\n')
    return "trial_a.txt", "trial_b.txt"


# Cameras: a geared pan axis with play, closed loop by a controller that nobody wrote down.
@njit
def _pan(reference, h, per, gap, noise):  # type: ignore[no-untyped-def]
    j_motor, j_load, b_motor, b_load, k, c = 0.004, 0.012, 0.03, 0.01, 900.0, 0.6
    n = len(reference)
    y, u = np.zeros(n), np.zeros(n)
    qm, wm, ql, wl, integral = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        y[i] = np.round((ql + noise[i]) / 1.5e-5) * 1.5e-5
        error = reference[i] - qm
        integral += error * h * per
        u[i] = 6.0 * error + 12.0 * integral - 0.22 * wm
        for _ in range(per):
            twist, rate = qm - ql, wm - wl
            torque = 0.0
            if twist > gap / 2:
                torque = max(k * (twist - gap / 2) + c * rate, 0.0)
            elif twist < -gap / 2:
                torque = min(k * (twist + gap / 2) + c * rate, 0.0)
            wm += h * (u[i] - b_motor * wm - torque) / j_motor
            wl += h * (torque - b_load * wl) / j_load
            qm += h * wm
            ql += h * wl
    return y, u


def pan_tilt(folder, rng):  # type: ignore[no-untyped-def]
    rate = 500.0
    for name, n in (("pan_fit", 10000), ("pan_val", 6000)):
        slow = signal.butter(3, 1.0, fs=rate, output="sos")
        reference = signal.sosfiltfilt(slow, staircase(n, 500, -0.8, 0.8, rng))
        y, u = _pan(reference, 1 / rate / 100, 100, np.radians(0.6), 1e-5 * rng.standard_normal(n))
        np.savez(
            folder / f"{name}.npz", ref_deg=np.degrees(reference), pos_deg=np.degrees(y),
            torque=u.astype(np.float32), dt=1 / rate,
        )  # fmt: skip
    (folder / "data.map.toml").write_text(
        'sample_time = 0.002\n[columns]\nr = { name = "ref_deg", unit = "deg" }\n'
        'u = { name = "torque", unit = "Nm" }\ny = { name = "pos_deg", unit = "deg" }\n'
    )
    return "pan_fit.npz", "pan_val.npz"


# Electronics: Wiener-Hammerstein, a diode between two filters.
def diode(folder, rng):  # type: ignore[no-untyped-def]
    rate, n = 51200.0, 4096
    front = signal.cheby1(3, 0.5, 4400, fs=rate * 4, output="sos")
    back = signal.cheby2(3, 40, 5000, fs=rate * 4, output="sos")
    with h5py.File(folder / "WienerHammer.mat", "w", userblock_size=512) as file:
        for name in ("est", "val"):
            u = multisine(n, rate, 10, 10000, 0.6, rng)
            inner = signal.sosfilt(front, signal.resample(u, 4 * n))
            inner = np.where(inner > 0.35, 0.35 + 0.25 * (inner - 0.35), inner)
            y = signal.sosfilt(back, inner)[::4] + 2e-4 * rng.standard_normal(n)
            file[f"u_{name}"], file[f"y_{name}"] = u[None, :], y[None, :]
        file["fs"] = np.array([[rate]])
    with (folder / "WienerHammer.mat").open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    (folder / "data.map.toml").write_text(
        "sample_time = 1.953125e-5\n"
        + "".join(
            f'[[recordings]]\nname = "{n}"\ncolumns = {{ u = {{ name = "u_{n}", unit = "V" }}, '
            f'y = {{ name = "y_{n}", unit = "V" }} }}\n'
            for n in ("est", "val")
        )
    )
    return "WienerHammer.mat::est", "WienerHammer.mat::val"


# A null: hot air in a tube, linear, with a dead time of three samples and noise of the process.
def hair_dryer(folder, rng):  # type: ignore[no-untyped-def]
    n, every = 2000, 0.08
    for name in ("dryer_1", "dryer_2"):
        u = np.where(staircase(n, 12, 0, 1, rng) > 0.5, 6.4, 3.4)
        model = signal.cont2discrete(([0.9], [0.08, 0.5, 1.0]), every)
        y = signal.lfilter(np.ravel(model[0]), model[1], np.concatenate([np.full(3, u[0]), u[:-3]]))
        y = y + signal.lfilter([0.02], [1, -0.9], rng.standard_normal(n)) + 0.4
        rows = np.column_stack([u, y + 0.005 * rng.standard_normal(n)])
        np.savetxt(folder / f"{name}.dat", rows, fmt="%.7e")
    (folder / "data.map.toml").write_text(
        'sample_time = 0.08\nheader = ["power", "temp"]\n[columns]\n'
        'u = { name = "power", unit = "W" }\ny = { name = "temp", unit = "V" }\n'
    )
    return "dryer_1.dat", "dryer_2.dat"


FIELDS = (
    Field("bouc_wen", "vibration, MAT 5", bouc_wen, {"hysteresis": {}}),
    Field(
        "dc_motor", "drive, German CSV", dc_motor,
        {"coulomb_friction": {"level": 0.03 * 0.9 / 0.055}, "saturation": {"limit": 17.0}},
        also=("input_delay", "actuator_lag"),  # the winding, 0.89 ms
    ),
    Field("sticky_valve", "process, dated TSV", sticky_valve, {"valve_stiction": {"band": 3.0}}),
    Field("room", "building, CSV in minutes", room, {"sensor_nonlinearity": {"level": 45.0}}),
    Field("mems", "microsystem, HDF5", mems, {"hardening_spring": {"cubic_coefficient": 0.012 / 0.45}}),
    Field("ship", "ship, blanks, knots", ship, {"quadratic_drag": {"coefficient": 2.4 * 0.514444**2}}),
    Field("pan_tilt", "camera, NPZ in degrees", pan_tilt, {"backlash": {"gap": 0.6}}),
    Field("diode", "electronics, MAT 7.3", diode, {"saturation": {}}, may_be_unnamed=True),
    Field("hair_dryer", "nothing missing, no header", hair_dryer, {}),
    Field(
        "arm", "robot, HDF5 in degrees", arm,
        {"gravity_torque": {"amplitude": 35.0}, "cogging": {"amplitude": 1.5}},
    ),
    Field("tank", "process, decimal commas", tank, {"outflow": {"empty": -60.0}}),
    Field("spindle", "heat, a second path", spindle, {}, may_be_unnamed=True),
)  # fmt: skip


def call(*arguments: str, at: Path) -> tuple[dict, str, float]:
    """(answer, what stood on stderr, CPU seconds) of one shipped command."""
    start = os.times()
    done = subprocess.run(
        [sys.executable, "-m", "ffl.cli", *arguments, "--json"], cwd=at, capture_output=True,
        text=True,
    )  # fmt: skip
    now = os.times()
    spent = now.children_user - start.children_user + now.children_system - start.children_system
    return (json.loads(done.stdout) if done.returncode == 0 else {}), done.stderr.strip(), spent


def one(field: Field, seed: int, folder: Path) -> dict:
    """The whole way of one recording."""
    rng = np.random.default_rng([seed, FIELDS.index(field)])
    fit, val = field.write(folder, rng)
    row = {"field": field.name, "about": field.about, "wanted": list(field.wanted)}
    began = time.perf_counter()
    model, said, cpu = "plant.toml", "", 0.0
    if not (folder / model).exists():
        model = "model/plant.toml"
        _, said, cpu = call(
            "identify",
            "linear",
            "--data",
            fit,
            "--map",
            "data.map.toml",
            "--out",
            "model",
            at=folder,
        )
    if not (folder / model).exists():
        return row | {"verdict": "refused", "said": said[-300:], "right": False}
    answer, said, more = call(
        "diagnose", "--model", model, fit, "--validate", val, "--map", "data.map.toml",
        "--out", "answer", at=folder,
    )  # fmt: skip
    if not answer:
        return row | {"verdict": "refused", "said": said[-300:], "right": False}
    found = {e["name"]: e for e in answer["effects"]}
    off = {
        f"{name}.{key}": round(found[name]["parameters"][key]["value"] / value - 1.0, 4)
        for name, values in field.wanted.items()
        if name in found
        for key, value in values.items()
    }
    verdict = answer["verdict"]
    right = verdict in ("unnamed", "partly_explained") and not found and field.may_be_unnamed
    if field.wanted:
        right = right or set(field.wanted) <= set(found) <= {*field.wanted, *field.also}
    elif not field.may_be_unnamed:
        right = verdict == "nothing_missing"
    proof = answer["validation"]
    return row | {
        "verdict": verdict,
        "names": {n: round(e["confidence"], 2) for n, e in found.items()},
        "off": off,
        "place": answer["location"].get("where", ""),
        "nrmse": [round(proof[k], 5) for k in ("nrmse_before", "nrmse_after", "noise_floor")],
        "right": bool(right),
        "cpu": round(cpu + more, 1),
        "wall": round(time.perf_counter() - began, 1),
    }


def draw(folder: Path, file: Path) -> None:
    """Three held-out recordings, as identified and as diagnosed, from the answers kept in `folder`."""
    import matplotlib.pyplot as plt

    from ffl.diagnose.proof.prove import run_plant
    from ffl.diagnose.recorded.trials import prepare
    from ffl.machines.simulator import Simulator
    from ffl.recordings import read_recording
    from ffl.systems import load_plant

    shown = (
        ("bouc_wen", "BoucWen_sweep.mat", "Bouc-Wen, sine sweep", "displacement [mm]", 1e3, 1.0),
        ("ship", "trial_b.txt", "ship", "speed [kn]", 1.0, 1 / 60),
        ("room", "week2.csv", "room, sensor ends at 45 degC", "temperature [degC]", 1.0, 1 / 3600),
    )
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.4), layout="constrained")
    for ax, (name, held, title, label, scale, clock) in zip(axes, shown, strict=True):
        at = folder / name
        x = read_recording(at / held, at / "data.map.toml")
        ax.plot(clock * x.t, scale * x.y, color="0.2", linewidth=0.8, label="measured")
        for path, colour, said in (
            ("model/plant.toml", "#d55e00", "error as identified"),
            ("answer/augmented.toml", "#0072b2", "error as diagnosed"),
        ):
            plant = load_plant(at / path)
            run = run_plant(plant, prepare(Simulator(plant), x, 1e-3 * float(np.std(x.y))))
            ax.plot(clock * x.t, scale * (x.y - run.y), color=colour, linewidth=0.8, label=said)
        ax.set(title=title, ylabel=label, xlabel={1.0: "s", 1 / 60: "min"}.get(clock, "h"))
        ax.grid(alpha=0.3)
    axes[0].legend(fontsize=8, loc="upper left")
    figure.savefig(file, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("names", nargs="*")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--picture", type=Path, help="draw what --keep has kept, and do no more")
    options = parser.parse_args()
    if options.picture and options.keep:
        draw(options.keep, options.picture)
        return
    rows = []
    for field in FIELDS:
        if options.names and field.name not in options.names:
            continue
        with tempfile.TemporaryDirectory() as home:
            folder = (options.keep or Path(home)).resolve() / field.name
            folder.mkdir(parents=True, exist_ok=True)
            rows.append(one(field, options.seed, folder))
        if not options.json:
            print(*rows[-1].items(), sep="\n  ", flush=True)
    if options.json:
        print(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
