"""Linear side of the challenge: zero-order hold, zeros-poles-gain, servo design, noise spectra."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.signal

from ffl.challenge.body import Body


@dataclass(frozen=True)
class Zpk:
    """Discrete-time zeros, poles and gain."""

    zeros: tuple[complex, ...]
    poles: tuple[complex, ...]
    gain: float

    def at(self, z: np.ndarray) -> np.ndarray:
        """Response at complex z, factor by factor."""
        value = np.full(np.shape(z), self.gain, complex)
        for k in range(max(len(self.zeros), len(self.poles))):
            if k < len(self.zeros):
                value = value * (z - self.zeros[k])
            if k < len(self.poles):
                value = value / (z - self.poles[k])
        return value

    @property
    def sections(self) -> np.ndarray:
        """Second-order sections (n, 6) of a system with as many zeros as poles."""
        if len(self.zeros) != len(self.poles):
            raise ValueError("sections need as many zeros as poles: zpk2sos drops the delay")
        return scipy.signal.zpk2sos(self.zeros, self.poles, self.gain)


def state_space(body: Body) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Continuous-time A, B, C of a body, command in, measured position out."""
    n = len(body.motor)
    inverse = np.linalg.inv(body.mass)
    a = np.block(
        [[np.zeros((n, n)), np.eye(n)], [-inverse @ body.stiffness, -inverse @ body.damping]]
    )
    b = np.concatenate([np.zeros(n), inverse @ body.motor * body.constant])
    return a, b, np.concatenate([body.gauge, body.gauge_rate])


def hold(body: Body, sample_time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Zero-order-hold equivalent A, B, C."""
    a, b, c = state_space(body)
    n = len(b)
    big = np.zeros((n + 1, n + 1))
    big[:n, :n], big[:n, n] = a, b
    e = scipy.linalg.expm(big * sample_time)
    return e[:n, :n], e[:n, n], c


def discrete_zpk(body: Body, sample_time: float) -> Zpk:
    """Zeros, poles and gain of the zero-order-hold equivalent, without any polynomial.

    Poles from the eigenvalues in continuous time (a body free to move has exact ones at 0),
    zeros as finite generalised eigenvalues of the system pencil, gain by comparison on a circle.
    """
    a, b, c = hold(body, sample_time)
    n = len(b)
    s = scipy.linalg.eigvals(state_space(body)[0])
    fastest = np.abs(s).max()
    s = np.where(np.abs(s) < 1e-6 * fastest, 0.0, s)
    s = np.where(np.abs(s.imag) < 1e-9 * fastest, s.real, s)
    poles = np.exp(s * sample_time)
    # Scale states so that the pencil's entries are of one size; the zeros do not change.
    scale = np.maximum(np.abs(b), 1e-12 * np.abs(b).max())
    a_s, b_s, c_s = a * scale / scale[:, None], b / scale, c * scale
    c_s = c_s / np.abs(c_s).max()
    pencil = np.block([[a_s, b_s[:, None]], [c_s[None, :], np.zeros((1, 1))]])
    weight = np.zeros((n + 1, n + 1))
    weight[:n, :n] = np.eye(n)
    alpha, beta = scipy.linalg.eigvals(pencil, weight, homogeneous_eigvals=True)
    finite = np.abs(beta) > 1e-5 * np.abs(alpha)  # the others lie at infinity
    zeros = alpha[finite] / beta[finite]
    zeros = np.where(np.abs(zeros.imag) < 1e-9 * np.abs(zeros), zeros.real, zeros)
    paired = _paired(zeros), _paired(poles)
    z = 1.05 * np.exp(1j * np.linspace(0.02, 3.0, 30))
    exact = np.array([c @ np.linalg.solve(v * np.eye(n) - a, b) for v in z])
    ratio = exact / Zpk(*paired, 1.0).at(z)
    return Zpk(*paired, float(np.median(ratio.real)))


def _paired(roots: np.ndarray) -> tuple[complex, ...]:
    """Real roots, then conjugate pairs that are conjugate to the last digit."""
    real = sorted(r.real for r in roots if abs(r.imag) == 0)
    above = sorted((r for r in roots if r.imag > 0), key=lambda r: (r.real, r.imag))
    out: list[complex] = [complex(r) for r in real]
    for r in above:
        out += [complex(r), complex(r).conjugate()]
    if len(out) != len(roots):
        raise ValueError(f"roots are not conjugate-complete: {roots}")
    return tuple(out)


@dataclass(frozen=True)
class Servo:
    """u_fb = C (r - y), or C_r r - C_y y where `output` is given."""

    reference: Zpk
    output: Zpk | None = None

    @property
    def feedback(self) -> Zpk:
        return self.output or self.reference


def _bilinear(zeros: list[float], poles: list[float], sample_time: float) -> Zpk:
    z, p, k = scipy.signal.bilinear_zpk(zeros, poles, 1.0, 1.0 / sample_time)
    return Zpk(tuple(complex(v) for v in z), tuple(complex(v) for v in p), float(k.real))


def design_servo(
    body: Body, sample_time: float, bandwidth: float, integral: bool, split: bool
) -> Servo:
    """Lead, low-pass and, if asked, an integrator; slower until max |S| < 2 (6 dB).

    `split`: the servo acts on the reference without its lead (position loop around a velocity
    loop, as drives have it), so reference and output have different filters.
    """
    f = np.geomspace(0.05, 0.499 / sample_time, 3000)
    z = np.exp(2j * np.pi * f * sample_time)
    plant = discrete_zpk(body, sample_time)
    response = plant.at(z)
    a, b, c = hold(body, sample_time)
    for _ in range(60):
        w = 2 * np.pi * bandwidth
        slow = [-w / 8] if integral else []
        low = [-w * 5, -w * 6]
        c0 = _bilinear([-w / 3, *slow], [*low, *([0.0] if integral else [])], sample_time)
        at = int(np.argmin(np.abs(f - bandwidth)))
        gain = 1.0 / abs(c0.at(z[at : at + 1])[0] * response[at])
        servo = Zpk(c0.zeros, c0.poles, c0.gain * gain)
        peak = np.abs(1 / (1 + servo.at(z) * response)).max()
        if peak < 2.0 and loop_is_stable(a, b, c, servo):
            if not split:
                return Servo(servo)
            # The same filter without the lead on the reference; equal gain at standstill.
            steady = _bilinear(slow, [*low[:1], *([0.0] if integral else [])], sample_time)
            near = np.array([1.0 + 1e-7])
            ratio = float((servo.at(near) / steady.at(near)).real[0])
            return Servo(Zpk(steady.zeros, steady.poles, steady.gain * ratio), servo)
        bandwidth *= 0.9
    raise ValueError("no servo with max |S| < 2 found")


def loop_is_stable(a: np.ndarray, b: np.ndarray, c: np.ndarray, servo: Zpk) -> bool:
    """Eigenvalues of the closed loop inside the unit circle."""
    ac, bc, cc, dc = scipy.signal.zpk2ss(servo.zeros, servo.poles, servo.gain)
    ac, bc, cc, dc = np.real(ac), np.real(bc)[:, 0], np.real(cc)[0], float(np.real(dc).item())
    loop = np.block([[a - np.outer(b, dc * c), np.outer(b, cc)], [-np.outer(bc, c), ac]])
    return bool(np.abs(np.linalg.eigvals(loop)).max() < 1 - 1e-6)


@dataclass(frozen=True)
class Noise:
    """White and first-order coloured noise of the sensor (output unit) and of the force (input)."""

    sensor: float = 0.0
    sensor_coloured: float = 0.0
    sensor_corner: float = 30.0
    force: float = 0.0
    force_coloured: float = 0.0
    force_corner: float = 20.0
    resolution: float = 0.0

    def scaled(self, factor: float) -> Noise:
        """All random parts times a factor; the encoder stays."""
        return Noise(
            self.sensor * factor,
            self.sensor_coloured * factor,
            self.sensor_corner,
            self.force * factor,
            self.force_coloured * factor,
            self.force_corner,
            self.resolution,
        )

    def draw(
        self, n: int, sample_time: float, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Sensor and force noise, n samples each."""
        out = []
        for white, coloured, corner in (
            (self.sensor, self.sensor_coloured, self.sensor_corner),
            (self.force, self.force_coloured, self.force_corner),
        ):
            a = np.exp(-2 * np.pi * corner * sample_time)
            x = scipy.signal.lfilter([np.sqrt(1 - a * a)], [1, -a], rng.standard_normal(n + 2000))
            out.append(white * rng.standard_normal(n) + coloured * x[2000:])
        return out[0], out[1]

    def density(
        self, plant: np.ndarray, feedback: np.ndarray, z: np.ndarray, sample_time: float
    ) -> np.ndarray:
        """Power of y's noise per sample and frequency (its mean over the circle is the variance)."""
        sensitivity = 1 / (1 + plant * feedback)
        parts = []
        for white, coloured, corner in (
            (self.sensor, self.sensor_coloured, self.sensor_corner),
            (self.force, self.force_coloured, self.force_corner),
        ):
            a = np.exp(-2 * np.pi * corner * sample_time)
            parts.append(white**2 + coloured**2 * (1 - a * a) / np.abs(1 - a / z) ** 2)
        sensor = parts[0] + self.resolution**2 / 12
        return np.abs(sensitivity) ** 2 * (sensor + np.abs(plant) ** 2 * parts[1])
