"""Plant file and recordings of a case as plain text."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ffl.challenge.draw import Experiment, Setup
from ffl.challenge.linear import Noise, Zpk, discrete_zpk


def _roots(roots: tuple[complex, ...]) -> str:
    items = [
        repr(float(r.real)) if r.imag == 0 else f"[{float(r.real)!r}, {float(r.imag)!r}]"
        for r in map(complex, roots)
    ]
    return "[" + ", ".join(items) + "]"


def _zpk(table: str, system: Zpk) -> list[str]:
    return [
        f"[{table}]",
        'form = "zpk"',
        f"zeros = {_roots(system.zeros)}",
        f"poles = {_roots(system.poles)}",
        f"gain = {float(system.gain)!r}",
    ]


def plant_text(setup: Setup, noise: Noise, fault: dict | None) -> str:
    """The nominal model as a plant file; what a fault makes untrue in it is untrue."""
    fault = fault or {}
    model = discrete_zpk(setup.nominal, setup.sample_time)
    lines = [
        f'name = "{setup.family}"',
        f"sample_time = {setup.sample_time!r}",
        'source = "nominal model of a machine of the challenge"',
        "[units]",
        'input = "A"' if setup.physics_known else 'input = "V"',
        'output = "m"',
        *_zpk("plant", model),
    ]
    if setup.servo is not None:
        factor = fault.get("controller_factor", 1.0)
        names = ["controller"]
        systems = [setup.servo.reference]
        if setup.servo.output is not None:
            names = ["controller.reference", "controller.output"]
            systems.append(setup.servo.output)
        for name, system in zip(names, systems, strict=True):
            lines += _zpk(name, Zpk(system.zeros, system.poles, system.gain * factor))
    if setup.physics_known:
        lines += [
            "[physics]",
            f"mass = {setup.nominal.moving_mass!r}",
            f"motor_constant = {setup.nominal.constant!r}",
        ]
    # An engineer knows the encoder and, to one digit, the noise of sensor and drive.
    sensor = np.hypot(noise.sensor, noise.sensor_coloured)
    force = np.hypot(noise.force, noise.force_coloured)
    lines += [
        "[machine]",
        f"encoder_resolution = {float(f'{noise.resolution:.6g}')!r}",
        f"sensor_noise = {float(f'{sensor:.1g}')!r}",
        f"force_noise = {float(f'{force:.1g}')!r}",
    ]
    return "\n".join(lines) + "\n"


def columns(
    e: Experiment, y: np.ndarray, u: np.ndarray, sample_time: float, stretch: float = 1.0
) -> np.ndarray:
    """The rows of a recording, (n_samples, 5): t, r, f, u, y. A wrong clock stretches t."""
    start = np.round(e.clock / sample_time)
    t = (start + np.arange(len(y))) * sample_time * stretch
    return np.column_stack([t, e.reference[e.skip :], e.feedforward[e.skip :], u, y]) + 0.0


def recording(
    path: Path,
    e: Experiment,
    y: np.ndarray,
    u: np.ndarray,
    sample_time: float,
    fault: dict | None,
    file: str,
) -> None:
    """CSV with the header t,r,f,u,y; a gap leaves rows out."""
    rows = columns(e, y, u, sample_time, (fault or {}).get("clock_factor", 1.0))
    gap = (fault or {}).get("gaps", {}).get(file)
    if gap is not None:
        rows = np.delete(rows, np.arange(*gap), axis=0)
    table(path, rows)


def table(path: Path, rows: np.ndarray) -> None:
    """Rows t, r, f, u, y as CSV, to 12 digits: enough for u = f + C (r - y) to hold."""
    np.savetxt(
        path,
        rows,
        fmt=["%.7f", "%.12g", "%.12g", "%.12g", "%.12g"],
        delimiter=",",
        header="t,r,f,u,y",
        comments="",
    )
