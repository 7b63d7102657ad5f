"""The report of a diagnosis: answer.json, augmented.toml and a page that shows every step."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ffl.diagnose import Diagnosis, diagnose
from ffl.diagnose.proof.advise import Experiment
from ffl.diagnose.result import NO_CHANCE
from ffl.effects import EFFECTS, check_effects
from ffl.effects.position_dependent_friction import is_cubic
from ffl.errors import InputError
from ffl.recordings import Recording, read_recording
from ffl.report import diagnosis_figures as draw
from ffl.report.page import Page, drawing, subplots
from ffl.report.transmission import print_transmission, transmission_section
from ffl.systems import load_plant, save_plant
from ffl.systems.atomic import write_text

VERDICTS = {
    "explained": "Physics that the model leaves out was found, and what is left is noise.",
    "partly_explained": "Physics that the model leaves out was found; structure remains.",
    "unnamed": "Something is there that no effect of the catalogue explains.",
    "nothing_missing": "Nothing is missing: what is left is noise.",
    "inconclusive": "These recordings cannot tell.",
}

WITHIN = (
    "What is left is within what noise alone would leave. That figure is an estimate, by the plant file "
    "and by what is left of the fitted recordings; these ones are quieter than it says."
)


def write(diagnosis: Diagnosis, folder: Path) -> None:
    """Writes answer.json, augmented.toml, the suggested experiment and report.html, each whole."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    answer = json.dumps(diagnosis.answer(), indent=1, allow_nan=False)
    write_text(folder / "answer.json", answer + "\n")
    save_plant(diagnosis.augmented, folder / "augmented.toml")
    if diagnosis.experiment is not None:
        write_text(folder / "experiment.csv", _table(diagnosis.experiment))
    page_of(diagnosis).write(folder / "report.html")


def _table(e: Experiment) -> str:
    """A reference file: t, r, f."""
    rows = zip(e.t, e.r, e.f, strict=True)
    return "t,r,f\n" + "".join(f"{t:.12g},{r:.12g},{f:.12g}\n" for t, r, f in rows)


def diagnose_with_report(
    model: Path,
    recordings: Sequence[Path],
    validation: Sequence[Path],
    mapping: Path | None,
    out: Path | None,
    quiet: bool = False,
) -> dict[str, Any]:
    """Reads the files, diagnoses, writes the folder `out` where one is given; the answer."""
    plant = load_plant(str(model))
    try:
        check_effects(plant)
    except InputError as error:
        raise InputError(f"{model}: {error}") from None

    def read(paths: Sequence[Path]) -> list[Recording]:
        step = plant.sample_time
        return [read_recording(p, mapping, sample_time=step) for p in paths]

    def say(line: str) -> None:
        print(f"ffl: {line}", file=sys.stderr, flush=True)

    try:
        found = diagnose(plant, read(recordings), read(validation), progress=None if quiet else say)
    except InputError as error:
        here = str(error).startswith(f"{plant.name}:")  # of the plant, not of a recording
        raise InputError(f"{model}: {error}" if here else str(error)) from None
    if out is not None:
        write(found, out)
    return found.answer()


def print_answer(answer: Mapping[str, Any]) -> None:
    """The answer in a few lines."""
    print(f"{answer['verdict']}: {_headline(answer['verdict'], 'validation' in answer)}")
    for e in answer["effects"]:
        at = _component(e["location"], e.get("options", {}))
        print(f"  {e['name']} ({at}, confidence {e['confidence']:.2f}): {e['says']}")
        known = {k: n for k, n in e["parameters"].items() if _plain(n["value"])}
        own = EFFECTS[e["name"]]
        numbers = [_with_error(k, n, own.parameter(k).is_place) for k, n in known.items()]
        if numbers:
            print(f"    {', '.join(numbers)}")
        for rival in (r for r in e["alternatives"] if r["confidence"] >= NO_CHANCE):
            print(f"    or {rival['name']} ({rival['confidence']:.2f})")
    for c in answer["model_corrections"]:
        said = (
            f"{c['relative']:+.3g} {c['unit']}" if "unit" in c else f"{100 * c['relative']:+.3g} %"
        )
        if "std_error" not in c and answer["verdict"] == "unnamed" and not answer["effects"]:
            said += ", beside the map, whose slope it may be"
        elif "std_error" not in c:
            said += ", as far as it may go: what stands behind it is something else"
        print(f"  model correction {c['name']}: {said}")
    if answer["location"].get("where"):
        print(f"  where: {answer['location']['where']}")
    if answer["location"].get("formula"):
        print(f"  formula: {answer['location']['formula']}")
    proof = answer.get("validation")
    if proof:
        print(f"  held out: nrmse {proof['nrmse_before']:.4g} -> {_left(proof)}, {_alone(answer)}")
        if "u_nrmse_after" in proof:
            alone = ""
            if "u_noise_floor" in proof and not proof.get("noise_untold"):
                alone = f", noise alone {proof['u_noise_floor']:.4g}"
            print(f"  command:  nrmse {proof['u_nrmse_before']:.4g} -> {_left(proof, 'u_')}{alone}")
    for line in answer["advice"]:
        print(f"  advice: {line}")
    for line in answer.get("notes", ()):
        print(f"  note: {line}")
    if "transmission" in answer:
        print_transmission(answer["transmission"])


def _left(proof: Mapping[str, Any], of: str = "") -> str:
    """The held-out error of y, or `of` "u_" of the command, with all that the answer has."""
    after = f"{proof[f'{of}nrmse_after']:.4g}"
    if "nrmse_with_map" not in proof:
        return after
    mapped = proof.get(f"{of}nrmse_with_map")
    if mapped is None:
        return f"{after} without the map"
    return f"{mapped:.4g} with the map (without it {after})"


def _alone(answer: Mapping[str, Any]) -> str:
    """What noise alone would leave, beside what is left: within it, unless that has structure."""
    proof = answer["validation"]
    if proof.get("noise_untold"):
        return "noise cannot be told from what is left"
    floor = float(proof["noise_floor"])
    within = proof.get("nrmse_with_map", proof["nrmse_after"]) <= floor
    said = f"noise alone {floor:.4g}" + (" by estimate" if within else "")
    structured = answer["verdict"] == "partly_explained"
    return f"{said}: what is left is within it" if within and not structured else said


def _component(location: str, options: Mapping[str, Any]) -> str:
    """The component, and which side of a coupling where the two were told apart."""
    side = options.get("side")
    return f"{location}, at the {side}" if side in ("motor", "load") else location


def _headline(verdict: str, proven: bool) -> str:
    """What a verdict says; one that came before any proof says what is to be done."""
    if verdict == "inconclusive" and not proven:
        return "Something is to be mended before these recordings can tell."
    return VERDICTS[verdict]


def _plain(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _with_error(name: str, number: Mapping[str, Any], place: bool = False) -> str:
    """`level 20.4 ± 0.31 N`: the error with two digits, the value as far as the error lets it; an amount
    that is smaller than its error is not told, a `place` is."""
    value, error = float(number["value"]), number.get("std_error")
    unit = "" if number["unit"] in ("", "1") else f" {number['unit']}"
    if not error:
        why = f" ({number['note']})" if number.get("note") else ""
        return f"{name} {value:.4g}{unit}{why}"
    if error > abs(value) and not place:
        return f"{name} not told ({value:.2g} ± {error:.2g}{unit})"
    digits = int(np.clip(np.ceil(np.log10(max(abs(value) / error, 1.0))) + 2, 2, 8))
    return f"{name} {value:.{digits}g} ± {error:.2g}{unit}"


def page_of(d: Diagnosis) -> Page:
    """The page, step by step."""
    page = Page(
        f"Diagnosis of {d.plant.name}",
        f"Verdict: {d.verdict}. {_headline(d.verdict, d.proof is not None)}",
    )
    with drawing():
        _overview(page, d)
    page.section("Is the recording sound?")
    for fault in d.soundness.faults:
        page.note(f"{fault.recording}: {fault.where}. {fault.mend}.", "bad")
    if d.soundness.consistency:
        worst = 100 * max(d.soundness.consistency)
        page.text(f"The stated controller reproduces the command to {worst:.3g} % of its RMS.")
    elif not d.soundness.faults:
        page.text(
            "No fault in times, gaps, sensor or units. No controller is stated, so nothing says whether "
            "the command is what was sent."
        )
    if d.transmission is not None:
        with drawing():
            transmission_section(page, d.transmission)
    if d.judged is None:
        return page
    with drawing():
        _where(page, d)
        _ladder(page, d)
        _proof(page, d)
        _experiment(page, d)
    for note in d.notes:
        page.note(note)
    return page


def _overview(page: Page, d: Diagnosis) -> None:
    page.section("What was found")
    for f in d.findings:
        at = _component(f.location, f.options)
        page.note(f"{f.name} ({at}, confidence {f.confidence:.2f}): {f.says}", "good")
        rows = [
            [name, n.value, n.unit, (n.note or None) if n.std_error is None else n.std_error]
            for name, n in f.parameters.items()
            if isinstance(n.value, int | float)
        ]
        if rows:
            page.table(["parameter", "value", "unit", "standard error"], rows)
        if "table" in f.parameters:
            figure, ax = subplots()
            levels = f.parameters["table"]
            draw.friction_table(
                ax, levels.value, levels.unit, d.plant.output_unit, smooth=is_cubic(f.options)
            )
            page.figure(figure, "Friction over position", "Levels of dry friction by direction.")
        if f.rivals:
            rivals = ", ".join(f"{name} ({p:.2f})" for name, p in f.rivals)
            page.text(f"Rivals that cannot be excluded: {rivals}.")
    if d.corrections:
        page.heading("Corrections of the linear model")
        page.table(
            ["number", "change", "standard error", "unit"],
            [[c.name, c.relative, c.std_error, c.unit or "of nominal"] for c in d.corrections],
        )
    if d.proof is not None:
        facts = [("nrmse before", d.proof.nrmse_before), ("nrmse after", d.proof.nrmse_after)]
        if d.proof.nrmse_with_map is not None:
            facts[1:] = [
                ("nrmse after, without the map", d.proof.nrmse_after),
                ("nrmse after, with the map", d.proof.nrmse_with_map),
            ]
        alone = "what is left, noise not told from it" if d.proof.untold else "noise alone"
        page.facts([*facts, (alone, d.proof.noise_floor)])
        if d.proof.within_noise:
            page.text(WITHIN)
    for line in d.advice:
        page.note(f"Next experiment: {line}")


def _experiment(page: Page, d: Diagnosis) -> None:
    if d.experiment is None:
        return
    page.section("What next? The experiment that would tell most")
    figure, axes = subplots(rows=1, columns=2, height=3.4, width_ratios=(1.0, 0.8))
    draw.experiment(axes[0], d.experiment, d.plant.output_unit, d.plant.input_unit)
    draw.separations(axes[1], d.experiment)
    page.figure(
        figure, d.experiment.text,
        "Left: the reference, in experiment.csv (t, r, f), within the range, speed, acceleration and "
        "command of the recordings. Right: what each experiment tried in simulation would tell.",
    )  # fmt: skip


def _where(page: Page, d: Diagnosis) -> None:
    page.section("Where?")
    if d.place.where:
        depends = ", ".join(d.place.depends_on)
        said = [d.place.where, depends and f"depends on {depends}"]
        said.append(d.place.component and f"component: {d.place.component}")
        page.text("; ".join(filter(None, said)) + ".")
    if d.place.formula:
        page.note(f"The simplest formula for what has no name: {d.place.formula}.", "good")
    if d.place.linear_share is not None:
        page.text(
            f"Coherence of the mismatch with what drives the machine: {d.place.linear_share:.2f} (1 where "
            "it goes linearly with it; slow moves in short windows read lower)."
        )
    if d.place.states:
        page.table(
            ["while the machine is in", "power of the mismatch"],
            [[s.name, s.power] for s in d.place.states],
            "Of the whitened residual before, relative to its mean over the recordings.",
        )
    if d.maps_before:
        top = max(10.0, float(np.quantile(d.maps_before[0].power, 0.999)))
        figure, axes = subplots(rows=1, columns=2, sharey=True)
        draw.mismatch_map(axes[0], d.maps_before[0], "before", top)
        draw.mismatch_map(axes[1], d.maps_after[0], "after", top)
        page.figure(
            figure, "Mismatch map",
            "Whitened residual of the first recording, time against frequency; 1 (pale) is noise "
            "alone. What lights up before and not after is what was found.",
        )  # fmt: skip
    for p in d.pictures:
        figure, ax = subplots()
        draw.map_with_data(ax, p)
        page.figure(
            figure, "What has no name",
            "A smooth map, free in form (line), over what the recording that shows most of it asks "
            "for at this port (dots), and the simplest formula found for it (dashed).",
        )  # fmt: skip
    if len(d.place.ports) > 1:
        figure, ax = subplots(height=0.9 + 0.35 * len(d.place.ports))
        draw.ports(ax, d.place.ports)
        page.figure(
            figure, "Where it enters",
            "An unknown signal at each port: how much better than none the recordings are explained "
            "by the best map there. Ports within a few units cannot be told apart.",
        )  # fmt: skip
    if d.forces:
        figure, axes = subplots(rows=1, columns=2)
        draw.force_against(axes[0], d.forces, "velocity")
        draw.force_against(axes[1], d.forces, "position")
        page.figure(
            figure, "Force that the linear model lacks",
            "The effects' force along the motion (line) over the force that the residual asks for "
            "(dots), against velocity and against position.",
        )  # fmt: skip


def _ladder(page: Page, d: Diagnosis) -> None:
    page.section("What? The ladder of hypotheses")
    for index, step in enumerate(d.steps):
        if not step.rivals:
            continue
        figure, ax = subplots(height=0.8 + 0.32 * len(step.rivals))
        draw.ladder(ax, step)
        page.figure(
            figure, f"Round {index + 1}: beside {step.before.name}",
            "What each rival adds to the log-likelihood of the fitted and of the held-out "
            "recordings, free numbers charged; the best is taken if it brings enough.",
        )  # fmt: skip


def _proof(page: Page, d: Diagnosis) -> None:
    if d.proof is None:
        return
    page.section("Proof on held-out recordings")
    mapped = d.proof.nrmse_with_map is not None
    after = "after, with the map" if mapped else "after"
    files = [Path(overlay.name).name for overlay in d.proof.overlays]
    for overlay, title in zip(d.proof.overlays, files, strict=True):
        if files.count(title) > 1:  # moves of one recording
            title += f", {overlay.t[0]:.4g} to {overlay.t[-1]:.4g} s"
        figure, axes = subplots(rows=2, columns=1, height=4.6, sharex=True)
        draw.overlay(axes[0], overlay, d.plant.output_unit, after)
        draw.errors(axes[1], overlay, d.plant.output_unit, after)
        page.figure(
            figure, f"{title}, before and after",
            ("Led to what was measured by an observer" if d.proof.observed else
             "Free-running simulation from the recording's own start") + "; nothing was fitted to it. "
            + "Below: what is left.",
        )  # fmt: skip
    p = d.proof
    header = ["signal", "nrmse before", "nrmse after", "noise alone"]
    rows = [["y", p.nrmse_before, p.nrmse_after, p.noise_floor]]
    if p.u_nrmse_before is not None:
        rows.append(["u", p.u_nrmse_before, p.u_nrmse_after, p.u_noise_floor])
    if mapped:  # what has no name is drawn above, and is no part of the plant file
        header[2:3] = ["nrmse after, without the map", "nrmse after, with the map"]
        for row, error in zip(rows, (p.nrmse_with_map, p.u_nrmse_with_map), strict=False):
            row.insert(3, error)
    low, high = p.interval
    page.table(
        header, rows,
        f"95 % interval of the change in y by paired block bootstrap{', without the map' * mapped}: "
        f"{low:.3g} to {high:.3g}.",
    )  # fmt: skip
