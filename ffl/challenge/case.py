"""One case of the challenge: a folder with a nominal plant file and recordings, and its truth."""

from __future__ import annotations

import json
import zlib
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from ffl.challenge import kernel, write
from ffl.challenge.body import FAMILIES
from ffl.challenge.build import Build, Scales
from ffl.challenge.detect import beyond, spectrum, tangents, whiten
from ffl.challenge.draw import Experiment, Setup, draw_noise, draw_setup, measure
from ffl.challenge.faults import FAULTS, spoil
from ffl.challenge.linear import Noise
from ffl.challenge.outside import OUTSIDE
from ffl.challenge.physics import EFFECTS
from ffl.errors import InputError, WorkError

CONCEALMENTS = ("none", "feedback", "noise", "masked", "outside", "weak")
DETECTABLE = 300.0  # least energy beyond the nominal parameters of an effect to be found
UNDETECTABLE = 3.0  # most whitened energy of an effect that is too weak


@dataclass(frozen=True)
class Part:
    """One effect of a case: its name, where it acts, its own seed and the factor on its size."""

    name: str
    at: str
    seed: int
    size: float

    def apply(self, build: Build, scales: Scales) -> dict:
        make = EFFECTS[self.name].make if self.name in EFFECTS else OUTSIDE[self.name].make
        return make(build, np.random.default_rng(self.seed), scales, self.at, self.size)


def assemble(setup: Setup, parts: list[Part], scales: Scales) -> tuple[Build, list[dict]]:
    """The true machine with its effects, and their parameters.

    Effects that change matrices come before those that read them.
    """
    build = Build.of(setup.true)
    order = sorted(range(len(parts)), key=lambda k: parts[k].name != "backlash")
    parameters: list[dict] = [{} for _ in parts]
    for k in order:
        parameters[k] = parts[k].apply(build, scales)
    return build, parameters


def run(build: Build, setup: Setup, e: Experiment, noise: Noise | None, rng=None):
    """y and u of one recording; noise-free without `noise`."""
    n = len(e.reference)
    sensor = force = external = lost = None
    if noise is not None:
        sensor, force = noise.draw(n, setup.sample_time, rng)
        build.sensor[kernel.RESOLUTION] = noise.resolution
        if build.knocks:
            external = np.zeros(n)
            for rate, size, width in build.knocks:
                for at in np.flatnonzero(rng.random(n) < rate * setup.sample_time):
                    k = np.arange(min(round(width / setup.sample_time), n - at))
                    pulse = np.sin(np.pi * k * setup.sample_time / width)
                    external[at + k] += size * rng.choice([-1, 1]) * pulse
        if build.loss > 0:
            lost = (rng.random(n) < build.loss).astype(float)
    y, u, *_ = build.run(
        setup.servo,
        e.reference,
        e.feedforward,
        setup.sample_time,
        setup.steps,
        sensor,
        force,
        external,
        lost,
        e.start,
    )
    build.sensor[kernel.RESOLUTION] = 0.0
    return y[e.skip :], u[e.skip :]


def _points(name: str, setup: Setup, rng: np.random.Generator) -> str:
    """Where an effect acts on this machine."""
    if name == "backlash":
        if setup.family.startswith("two_mass"):
            return "transmission"
        return "transmission" if setup.family == "rigid" and rng.random() < 0.6 else "output"
    return "load" if setup.family.startswith("two_mass") and rng.random() < 0.5 else "motor"


@dataclass(frozen=True)
class Trace:
    """What effects leave in the fitting recordings."""

    share: float  # peak of the trace in y over y's range
    power: float  # variance of the trace over variance of the noise in y
    energy: float  # whitened
    beyond: float  # whitened, outside what nominal parameters can explain
    sound: bool  # the machine stayed in its bounds


def trace(setup, parts, rest, scales, noise, basis, seed) -> Trace:
    """Trace of `parts` on top of the effects `rest`."""
    with_all, _ = assemble(setup, parts + rest, scales)
    without, _ = assemble(setup, rest, scales)
    random = bool(with_all.knocks or with_all.loss)
    quiet = noise.scaled(0.0) if random else None
    difference, peak, sound = [], 0.0, True
    for k, e in enumerate(setup.fit):
        y1, _ = run(with_all, setup, e, quiet, np.random.default_rng([seed, k]))
        y0, _ = run(without, setup, e, None)
        if not np.all(np.isfinite(y1)) or np.ptp(y1) > 4 * max(np.ptp(y0), 1e-12):
            return Trace(np.inf, np.inf, np.inf, np.inf, False)
        difference.append(y1 - y0)
        peak = max(peak, np.abs(y1 - y0).max() / np.ptp(y1))
    white = whiten(setup, noise, difference)
    power = float(np.mean(np.concatenate(difference) ** 2))
    floor = float(np.mean(spectrum(setup, noise, len(difference[0]))))
    return Trace(
        float(peak), power / floor, float(white @ white), beyond(white, basis, parts[0].name), sound
    )


def _fit_size(setup, parts, scales, noise, basis, concealment, seed):
    """Adjust sizes and noise until the concealment and the detection threshold are met."""
    for _ in range(9):
        found = [
            trace(setup, [p], parts[:k] + parts[k + 1 :], scales, noise, basis, seed)
            for k, p in enumerate(parts)
        ]
        if not all(t.sound for t in found):
            parts = [replace(p, size=p.size * 0.5) for p in parts]
            continue
        change = 1.0
        if concealment == "weak":
            if found[0].energy <= UNDETECTABLE:
                return parts, noise, found
            change = np.clip(np.sqrt(0.6 * UNDETECTABLE / found[0].energy), 1e-3, 0.9)
            parts = [replace(parts[0], size=parts[0].size * change), *parts[1:]]
            continue
        if concealment == "noise" and not 0.8 < found[0].power < 1.25:
            # More noise or, where believable noise would not hide it, a smaller effect too.
            noise = noise.scaled(float(np.clip(np.sqrt(found[0].power), 0.3, 20.0)))
            continue
        weak = [t.beyond < DETECTABLE for t in found]
        if concealment == "feedback" and found[0].share > 0.05 and not weak[0]:
            parts = [replace(parts[0], size=parts[0].size * 0.6), *parts[1:]]
            continue
        if not any(weak):
            return parts, noise, found
        parts = [
            replace(p, size=p.size * 1.6) if w else p for p, w in zip(parts, weak, strict=True)
        ]
    return None


def _component(name: str) -> str:
    return EFFECTS[name].component if name in EFFECTS else OUTSIDE[name].component


def _truth_effect(part: Part, parameters: dict, setup: Setup, found: Trace) -> dict:
    """An effect's entry: the catalogue's parameters, in N or in the input's unit."""
    factor = 1.0 if setup.physics_known else 1.0 / setup.true.constant
    forces = EFFECTS[part.name].dimension if part.name in EFFECTS else ()

    def convert(key, value):
        if key == "table":
            return {
                k: (np.array(v) * (1.0 if k == "grid" else factor)).tolist()
                for k, v in value.items()
            }
        return value if isinstance(value, str) else float(value * (factor if key in forces else 1))

    return {
        "name": part.name,
        "location": _component(part.name),
        "acts_at": part.at,
        "parameters": {k: convert(k, v) for k, v in parameters.items()},
        "trace_share": found.share,
        "power_ratio": found.power,
        "energy": found.energy,
        "energy_beyond_nominal": found.beyond,
    }


def make_case(
    seed: int,
    effect: str | tuple[str, ...] | None = None,
    machine: str = "rigid",
    concealment: str = "none",
    *,
    out_dir: Path | str,
    truth_dir: Path | str,
    name: str = "case",
    doubt: str = "careful",
    fault: str | None = None,
) -> dict:
    """Write `out_dir/name/` (plant.toml, fit_*.csv, validate_*.csv) and `truth_dir/name.json`.

    Args:
        effect: a name of EFFECTS or OUTSIDE, several, or None for nothing missing.
        machine: a name of FAMILIES.
        concealment: "none", "feedback", "noise", "masked", "outside" or "weak". "masked" puts a
            nominal parameter 5 to 10 % off on top; a larger second effect is asked for by giving
            two effects.
        doubt: nominal parameters "careful", "wrong" (still corrections by the contract), "exact".
        fault: a name of FAULTS, what goes wrong in recording.

    Returns the truth. Raises InputError where the combination cannot be, WorkError where forty
    draws did not give a sound machine with the concealment asked for.
    """
    names = () if effect is None else (effect,) if isinstance(effect, str) else tuple(effect)
    for item in names:
        if item not in EFFECTS and item not in OUTSIDE:
            raise InputError(
                f"effect '{item}' is unknown; one of {', '.join([*EFFECTS, *OUTSIDE])}"
            )
        only = EFFECTS[item].machines if item in EFFECTS else ()
        if only and machine not in only:
            raise InputError(f"effect '{item}' does not go with machine '{machine}': {only}")
    if concealment not in CONCEALMENTS:
        raise InputError(f"concealment '{concealment}' is unknown; one of {CONCEALMENTS}")
    if concealment == "feedback" and machine == "stiffness":
        raise InputError("the stiffness-driven stage has no feedback to hide behind")
    if fault is not None and fault not in FAULTS:
        raise InputError(f"fault '{fault}' is unknown; one of {', '.join(FAULTS)}")
    key = zlib.crc32(repr((names, machine, concealment, doubt, fault)).encode())
    for attempt in range(40):
        rng = np.random.default_rng([seed, key, attempt])
        case = _draw(names, machine, concealment, doubt, fault, rng)
        if case is not None:
            break
    else:
        raise WorkError(f"no sound case for {names} on {machine}, {concealment}, seed {seed}")
    setup, parts, scales, noise, found = case
    build, parameters = assemble(setup, parts, scales)
    effects = [
        _truth_effect(p, q, setup, t) for p, q, t in zip(parts, parameters, found, strict=True)
    ]
    recordings, oracle = {}, {}
    random = bool(build.knocks or build.loss)
    for label, plan in (("fit", setup.fit), ("validate", setup.validate)):
        for k, e in enumerate(plan):
            file = f"{label}_{k + 1}.csv"
            y, u = run(
                build, setup, e, noise, np.random.default_rng([seed, key, 77, k, len(label)])
            )
            recordings[file] = (e, y, u)
            if label == "validate" and not random:
                y0, u0 = run(build, setup, e, None)
                oracle[file] = {
                    "nrmse_after": float(np.std(y - y0) / np.std(y)),
                    "u_nrmse_after": float(np.std(u - u0) / np.std(u)),
                }
    truth = {
        "schema": 1,
        "case": name,
        "seed": seed,
        "machine": machine,
        "concealment": concealment,
        "doubt": doubt,
        "effects": effects,
        "corrections": setup.corrections,
        "oracle": oracle,
        "noise": asdict(noise),
        "experiments": {file: item[0].kind for file, item in recordings.items()},
        "fault": None,
        "parameters_of_machine": setup.parameters,
    }
    _expected(truth, setup)
    if fault is not None:
        truth["fault"] = spoil(fault, recordings, setup, rng)
        truth["verdicts"] = ["inconclusive", "refused"]
    folder = Path(out_dir) / name
    write.plant(folder / "plant.toml", setup, noise, truth["fault"])
    for file, (e, y, u) in recordings.items():
        write.recording(folder / file, e, y, u, setup.sample_time, truth["fault"], file)
    Path(truth_dir).mkdir(parents=True, exist_ok=True)
    text = json.dumps(truth, indent=1, sort_keys=True)
    (Path(truth_dir) / f"{name}.json").write_text(text + "\n")
    return truth


def _draw(names, machine, concealment, doubt, fault, rng):
    if concealment == "masked" and len(names) == 1:
        choices = [
            key for key, _ in FAMILIES[machine].doubts if key not in ("viscous", "zeta", "z2")
        ]
        if machine == "stiffness" or names[0] in ("mass_change", "flexible_mode"):
            choices = [key for key in choices if key != "mass"] or ["mass"]
        doubt = str(rng.choice(choices))
    setup = draw_setup(machine, doubt, rng)
    if fault in ("clipped_sensor", "wrong_controller") and setup.servo is None:
        return None
    scales = measure(setup)
    noise = draw_noise(setup, scales, rng)
    parts = [Part(n, _points(n, setup, rng), int(rng.integers(2**31)), 1.0) for n in names]
    if len(parts) == 2 and concealment == "masked":
        parts[1] = replace(parts[1], size=1.6)
    if not parts:
        return setup, parts, scales, noise, []
    basis = tangents(setup, noise)
    fitted = _fit_size(setup, parts, scales, noise, basis, concealment, int(rng.integers(2**31)))
    if fitted is None:
        return None
    parts, noise, found = fitted
    if not _sound(setup, parts, scales, noise, rng):
        return None
    return setup, parts, scales, noise, found


def _sound(setup, parts, scales, noise, rng) -> bool:
    """The judging recordings too stay within the machine's bounds."""
    build, _ = assemble(setup, parts, scales)
    plain = Build.of(setup.true)
    for e in setup.validate:
        y, _ = run(build, setup, e, noise, rng)
        y0, _ = run(plain, setup, e, None)
        if not np.all(np.isfinite(y)) or np.ptp(y) > 4 * np.ptp(y0):
            return False
    return True


def _expected(truth: dict, setup: Setup) -> None:
    """Set the right verdicts, and count a wrong mass as the effect that the contract makes it."""
    wrong = setup.corrections.get("mass", 0.0)
    if abs(wrong) > 0.02 and all(e["name"] != "mass_change" for e in truth["effects"]):
        truth["effects"].append(
            {
                "name": "mass_change",
                "location": "plant",
                "acts_at": "all",
                "parameters": {"change": wrong},
            }
        )
    strange = [e for e in truth["effects"] if e["name"] in OUTSIDE]
    if truth["concealment"] == "weak":
        truth["verdicts"] = ["nothing_missing", "inconclusive"]
    elif strange:
        truth["verdicts"] = ["unnamed", "partly_explained"]
        truth["depends_on"] = list(OUTSIDE[strange[0]["name"]].depends_on)
    elif truth["effects"]:
        truth["verdicts"] = ["explained", "partly_explained"]
    else:
        truth["verdicts"] = ["nothing_missing"]
