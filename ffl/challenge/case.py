"""One case of the challenge: a folder with a nominal plant file and recordings, and its truth."""

from __future__ import annotations

import json
import zlib
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from ffl.challenge import write
from ffl.challenge.body import FAMILIES
from ffl.challenge.build import Build, Scales
from ffl.challenge.detect import Lens
from ffl.challenge.draw import Setup, draw_noise, draw_setup, measure
from ffl.challenge.faults import FAULTS, spoil
from ffl.challenge.fitted import fitted, floors_of
from ffl.challenge.linear import Noise
from ffl.challenge.oracle import rivals
from ffl.challenge.outside import OUTSIDE
from ffl.challenge.physics import EFFECTS
from ffl.challenge.stage import Part, assemble, run, whole_run
from ffl.errors import InputError, WorkError
from ffl.systems.atomic import write_text

CONCEALMENTS = ("none", "feedback", "noise", "masked", "outside", "weak")
DETECTABLE = 300.0  # least energy beyond the nominal parameters of an effect to be found
DETECTABLE_IN_NOISE = 100.0  # the same where noise and trace have equal power
ATTEMPTS = 25
LINE = 0.02  # of the mass, or of the RMS force: less is a correction of the model by the contract
CLEARLY = 1.1  # times the line, from which a damping or a spring is an effect
UNDETECTABLE = 3.0  # most whitened energy of an effect that is too weak


def _points(name: str, setup: Setup, rng: np.random.Generator) -> str:
    """Where an effect acts on this machine."""
    if name == "backlash":
        if setup.family.startswith("two_mass"):
            return "transmission"
        return "transmission" if setup.family == "rigid" and rng.random() < 0.6 else "output"
    return "load" if setup.family.startswith("two_mass") and rng.random() < 0.5 else "motor"


@dataclass(frozen=True)
class Trace:
    """What one effect leaves in the fitting recordings."""

    share: float  # peak of the trace in y over y's range
    power: float  # variance of the trace over variance of the noise in y
    energy: float  # whitened
    beyond: float  # whitened, outside what nominal parameters can explain


def _differences(
    setup: Setup, parts: list[Part], k: int, scales: Scales, seed: int
) -> tuple[list[np.ndarray], float] | None:
    """Traces in y of effect k on top of the others, from the machine's start, and the peak of their
    recorded part over y's range; None where the machine leaves its bounds."""
    rest = parts[:k] + parts[k + 1 :]
    with_all, _ = assemble(setup, [parts[k], *rest], scales)
    without, _ = assemble(setup, rest, scales)
    out, peak = [], 0.0
    for j, e in enumerate(setup.fit):
        quiet = Noise() if with_all.random else None
        y1, _ = whole_run(with_all, setup, e, quiet, np.random.default_rng([seed, j]))
        y0, _ = whole_run(without, setup, e, None)
        out.append(y1 - y0)
        y1, y0 = y1[e.skip :], y0[e.skip :]
        if not np.all(np.isfinite(y1)) or np.ptp(y1) > 4 * max(np.ptp(y0), 1e-12):
            return None
        peak = max(peak, float(np.abs(y1 - y0).max() / np.ptp(y1)))
    return out, peak


def _fit_size(setup, parts, scales, noise, concealment, seed):
    """Adjust sizes and noise until the concealment and the detection threshold are met."""
    lens = Lens(setup)
    made: list[tuple[list[np.ndarray], float]] = []
    for turn in range(9):
        if not made:
            tried = [_differences(setup, parts, k, scales, seed) for k in range(len(parts))]
            made = [m for m in tried if m is not None]
            if len(made) < len(parts):
                parts, made = [replace(p, size=p.size * 0.5) for p in parts], []
                continue
        floor = np.mean(lens.spectrum(noise, 0))
        found = []
        for part, (traces, peak) in zip(parts, made, strict=True):
            white = lens.whiten(noise, traces)
            recorded = [x[e.skip :] for x, e in zip(traces, setup.fit, strict=True)]
            power = float(np.mean(np.concatenate(recorded) ** 2) / floor)
            left = lens.beyond(noise, white, part.name)
            found.append(Trace(peak, power, float(white @ white), left))
        first = found[0]
        factors = np.ones(len(parts))
        if concealment == "weak":
            if first.energy <= UNDETECTABLE:
                return parts, noise, found
            factors[0] = np.clip(np.sqrt(0.6 * UNDETECTABLE / first.energy), 1e-3, 0.9)
        elif concealment == "noise" and not 0.8 < first.power < 1.25:
            # A smaller effect and more noise, half of the way each; then the noise alone.
            smaller = float(np.clip(first.power**-0.25, 0.2, 1.0)) if turn == 0 else 1.0
            if smaller == 1.0:
                noise = noise.scaled(float(np.clip(np.sqrt(first.power), 0.1, 300.0)))
                continue
            factors[0] = smaller
        else:
            threshold = DETECTABLE_IN_NOISE if concealment == "noise" else DETECTABLE
            weak = np.array([t.beyond < threshold for t in found])
            if concealment == "feedback" and first.share > 0.05 and not weak[0]:
                factors[0] = 0.6
            elif not weak.any():
                return parts, noise, found
            elif concealment == "noise" and weak[0]:
                return None  # a larger effect would only ask for more noise
            else:
                factors[weak] = 1.6
        parts = [replace(p, size=p.size * float(f)) for p, f in zip(parts, factors, strict=True)]
        made = []
    return None


def _component(name: str) -> str:
    return EFFECTS[name].component if name in EFFECTS else OUTSIDE[name].component


def _damping_that_lacks(setup: Setup) -> float:
    """By how much the machine's own damping, without effects, is above what the nominal model has, N s/m:
    an effect is counted beside what the model has (INTERFACES.md), and this is in it."""
    wrong = setup.corrections
    if setup.family == "stiffness":  # 2 zeta omega m
        ratio = np.prod([1.0 + wrong.get(k, 0.0) for k in ("zeta", "frequency", "mass")])
        return float(setup.true.damping[0, 0] * (1.0 - 1.0 / ratio))
    error = wrong.get("viscous", 0.0)
    return float(setup.parameters.get("viscous", 0.0) * error / (1.0 + error))


def _beside_the_own_spring(parameters: dict, setup: Setup) -> dict:
    """The added spring with what the machine's own has more than the nominal model's, which pulls to 0: one
    spring, of their joint stiffness, to where they hold each other."""
    if setup.family != "stiffness":  # m omega^2
        return parameters
    wrong = setup.corrections
    ratio = (1.0 + wrong.get("mass", 0.0)) * (1.0 + wrong.get("frequency", 0.0)) ** 2
    own = parameters["stiffness"]
    whole = own + float(setup.true.stiffness[0, 0] * (1.0 - 1.0 / ratio))
    return {**parameters, "stiffness": whole, "centre": parameters["centre"] * own / whole}


def _truth_effect(part: Part, parameters: dict, setup: Setup, found: Trace) -> dict:
    """An effect's entry: the catalogue's parameters, in N or in the input's unit."""
    factor = 1.0 if setup.physics_known else 1.0 / setup.true.constant
    forces = EFFECTS[part.name].dimension if part.name in EFFECTS else ()

    def convert(key, value):
        if key == "table":
            by = {"grid": 1.0}
            return {k: (np.array(v) * by.get(k, factor)).tolist() for k, v in value.items()}
        return value if isinstance(value, str) else float(value * (factor if key in forces else 1))

    if part.name == "viscous_friction":
        parameters = {"coefficient": parameters["coefficient"] + _damping_that_lacks(setup)}
    if part.name == "linear_stiffness":
        parameters = _beside_the_own_spring(parameters, setup)
    if part.name == "mass_change":  # the mass that the nominal model lacks is in it
        lacks = setup.corrections.get("mass", 0.0)
        parameters = {"change": (1.0 + parameters["change"]) * (1.0 + lacks) - 1.0}
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
    truth_dir: Path | str | None = None,
    name: str = "case",
    doubt: str = "careful",
    fault: str | None = None,
    oracle: bool = False,
) -> dict:
    """Write `out_dir/name/` (plant.toml, fit_*.csv, validate_*.csv), `truth_dir/name.json`.

    Args:
        effect: a name of EFFECTS or OUTSIDE, several, or None for nothing missing.
        machine: a name of FAMILIES.
        concealment: "none", "feedback", "noise", "masked", "outside" or "weak". "masked" puts a
            nominal parameter 5 to 10 % off on top; a larger second effect is asked for by giving
            two effects.
        doubt: nominal parameters "careful", "wrong" (still corrections by the contract), "exact".
        fault: a name of FAULTS, what goes wrong in recording.
        oracle: also find the rivals that the recordings cannot tell from each effect, and what the
            true structure leaves held out once fitted (seconds).

    Returns the truth. Raises InputError where the combination cannot be, WorkError where
    no draw of ATTEMPTS gave a sound machine with the concealment asked for.
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
    if concealment == "masked" and machine == "stiffness" and len(names) == 1:
        raise InputError(
            "a wrong mass or stiffness of the stiffness-driven stage is an effect of its own; "
            "mask with a second effect"
        )
    if fault is not None and fault not in FAULTS:
        raise InputError(f"fault '{fault}' is unknown; one of {', '.join(FAULTS)}")
    key = zlib.crc32(repr((names, machine, concealment, doubt, fault)).encode())
    for attempt in range(ATTEMPTS):
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
    recordings, floors, added = {}, {}, []
    if oracle:
        for entry, part in zip(effects, parts, strict=True):
            entry["rivals"] = rivals(setup, part, parts, scales, noise)
        if not build.random:
            added = fitted(setup, parts, scales, noise)
    for label, plan in (("fit", setup.fit), ("validate", setup.validate)):
        for k, e in enumerate(plan):
            file = f"{label}_{k + 1}.csv"
            y, u = run(
                build, setup, e, noise, np.random.default_rng([seed, key, 77, k, len(label)])
            )
            recordings[file] = (e, y, u)
            if label == "validate" and not build.random:
                y0, u0 = run(build, setup, e, None)
                floors[file] = floors_of(y, y0, u, u0, added[k] if added else None)
    truth = {
        "schema": 1,
        "case": name,
        "kind": _kind(names, concealment, doubt, fault),
        "seed": seed,
        "machine": machine,
        "concealment": concealment,
        "doubt": doubt,
        "effects": effects,
        "corrections": setup.corrections,
        "oracle": floors,
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
    write_text(folder / "plant.toml", write.plant_text(setup, noise, truth["fault"]))
    for file, (e, y, u) in recordings.items():
        write.recording(folder / file, e, y, u, setup.sample_time, truth["fault"], file)
    if truth_dir is not None:
        text = json.dumps(truth, indent=1, sort_keys=True)
        write_text(Path(truth_dir) / f"{name}.json", text + "\n")
    return truth


def _kind(names: tuple[str, ...], concealment: str, doubt: str, fault: str | None) -> str:
    """What the composition calls such a case."""
    if fault is not None:
        return "fault"
    if not names:
        return "parameter" if doubt == "wrong" else "null"
    if concealment == "weak":
        return "weak"
    if any(n in OUTSIDE for n in names):
        return "outside"
    return "single" if len(names) == 1 else "several"


def _draw(names, machine, concealment, doubt, fault, rng):
    if concealment == "masked" and len(names) == 1:
        choices = [
            key for key, _ in FAMILIES[machine].doubts if key not in ("viscous", "zeta", "z2")
        ]
        if names[0] in ("mass_change", "flexible_mode"):
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
    fitted = _fit_size(setup, parts, scales, noise, concealment, int(rng.integers(2**31)))
    if fitted is None:
        return None
    parts, noise, found = fitted
    if not _sound(setup, parts, scales, noise, rng) or not _beyond_the_line(setup, parts, scales):
        return None
    if concealment != "weak" and _swallowed(setup, parts, scales, noise):
        return None
    return setup, parts, scales, noise, found


def _sound(
    setup: Setup, parts: list[Part], scales: Scales, noise: Noise, rng: np.random.Generator
) -> bool:
    """The judging recordings too stay within the machine's bounds."""
    build, _ = assemble(setup, parts, scales)
    plain = Build.of(setup.true)
    for e in setup.validate:
        y, _ = run(build, setup, e, noise, rng)
        y0, _ = run(plain, setup, e, None)
        if not np.all(np.isfinite(y)) or np.ptp(y) > 4 * np.ptp(y0):
            return False
    return True


def _beyond_the_line(setup: Setup, parts: list[Part], scales: Scales) -> bool:
    """A damping and a spring are effects by the contract in the machine as it is: beside a strong
    friction the same damper may be less than 2 % of the RMS force, a correction of the model. So is a
    mass that a wrong nominal one has swallowed."""
    if not {"viscous_friction", "linear_stiffness", "mass_change"} & {p.name for p in parts}:
        return True
    build, parameters = assemble(setup, parts, scales)
    there = measure(setup, build)
    stated = 1.0 + setup.corrections.get("mass", 0.0)
    for part, own in zip(parts, parameters, strict=True):
        if part.name == "mass_change" and abs(stated * (1 + own["change"]) - 1) < CLEARLY * LINE:
            return False
        pushes = {
            "viscous_friction": own.get("coefficient", 0.0) * there.speed_rms,
            "linear_stiffness": own.get("stiffness", 0.0) * there.position_rms,
        }
        if pushes.get(part.name, np.inf) < CLEARLY * LINE * there.force_rms:
            return False
    return True


def _swallowed(setup: Setup, parts: list[Part], scales: Scales, noise: Noise) -> bool:
    """A mode that a wrong resonance of the model, moved farther, makes up for: nothing shows it, not even
    where it is alone."""
    for part in parts:
        if part.name == "flexible_mode":
            build, _ = assemble(setup, [part], scales)
            runs = [whole_run(build, setup, e, None)[0] for e in setup.fit]
            if Lens(setup).beyond_moved(noise, runs) < DETECTABLE_IN_NOISE:
                return True
    return False


def _expected(truth: dict, setup: Setup) -> None:
    """Set the right verdicts, and count a wrong mass as the effect that the contract makes it."""
    wrong = setup.corrections.get("mass", 0.0)
    if abs(wrong) > LINE and all(e["name"] != "mass_change" for e in truth["effects"]):
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
