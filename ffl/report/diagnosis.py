"""The report of a diagnosis: answer.json, augmented.toml and a page that shows every step."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ffl.diagnose import Diagnosis, diagnose
from ffl.recordings import Recording, read_recording
from ffl.report import diagnosis_figures as draw
from ffl.report.page import Page, drawing, subplots
from ffl.systems import load_plant, save_plant
from ffl.systems.atomic import write_text

VERDICTS = {
    "explained": "Physics that the model leaves out was found, and what is left is noise.",
    "partly_explained": "Physics that the model leaves out was found; structure remains.",
    "unnamed": "Something is there that no effect of the catalogue explains.",
    "nothing_missing": "Nothing is missing: what is left is noise.",
    "inconclusive": "These recordings cannot tell.",
}


def write(diagnosis: Diagnosis, folder: Path) -> None:
    """Writes answer.json, augmented.toml, the suggested experiment and report.html, each whole."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    answer = json.dumps(diagnosis.answer(), indent=1, allow_nan=False)
    write_text(folder / "answer.json", answer + "\n")
    save_plant(diagnosis.augmented, folder / "augmented.toml")
    page_of(diagnosis).write(folder / "report.html")


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

    def read(paths: Sequence[Path]) -> list[Recording]:
        step = plant.sample_time
        return [read_recording(p, mapping, sample_time=step) for p in paths]

    def say(line: str) -> None:
        print(f"ffl: {line}", file=sys.stderr, flush=True)

    found = diagnose(plant, read(recordings), read(validation), progress=None if quiet else say)
    if out is not None:
        write(found, out)
    return found.answer()


def print_answer(answer: Mapping[str, Any]) -> None:
    """The answer in a few lines."""
    print(f"{answer['verdict']}: {VERDICTS[answer['verdict']]}")
    for e in answer["effects"]:
        print(f"  {e['name']} ({e['location']}, confidence {e['confidence']:.2f}): {e['says']}")
        for rival in e["alternatives"]:
            print(f"    or {rival['name']} ({rival['confidence']:.2f})")
    for c in answer["model_corrections"]:
        print(f"  model correction {c['name']}: {100 * c['relative']:+.3g} %")
    if answer["location"].get("where"):
        print(f"  where: {answer['location']['where']}")
    proof = answer.get("validation")
    if proof:
        print(
            f"  held out: nrmse {proof['nrmse_before']:.4g} -> {proof['nrmse_after']:.4g}, noise "
            f"alone {proof['noise_floor']:.4g}"
        )
        if "u_nrmse_after" in proof:
            print(
                f"  command:  nrmse {proof['u_nrmse_before']:.4g} -> {proof['u_nrmse_after']:.4g}"
            )
    for line in answer["advice"]:
        print(f"  advice: {line}")


def page_of(d: Diagnosis) -> Page:
    """The page, step by step."""
    page = Page(f"Diagnosis of {d.plant.name}", f"Verdict: {d.verdict}. {VERDICTS[d.verdict]}")
    _overview(page, d)
    page.section("Is the recording sound?")
    for fault in d.soundness.faults:
        page.note(f"{fault.recording}: {fault.where}. {fault.mend}.", "bad")
    if d.soundness.consistency:
        worst = 100 * max(d.soundness.consistency)
        page.text(f"The stated controller reproduces the command to {worst:.3g} % of its RMS.")
    if d.judged is None:
        return page
    with drawing():
        _where(page, d)
        _ladder(page, d)
        _proof(page, d)
    for note in d.notes:
        page.note(note)
    return page


def _overview(page: Page, d: Diagnosis) -> None:
    page.section("What was found")
    for f in d.findings:
        page.note(f"{f.name} ({f.location}, confidence {f.confidence:.2f}): {f.says}", "good")
        rows = [
            [name, n.value, n.unit, n.std_error]
            for name, n in f.parameters.items()
            if isinstance(n.value, int | float)
        ]
        if rows:
            page.table(["parameter", "value", "unit", "standard error"], rows)
        if f.alternatives:
            rivals = ", ".join(f"{name} ({p:.2f})" for name, p in f.alternatives)
            page.text(f"Rivals that cannot be excluded: {rivals}.")
    if d.corrections:
        page.heading("Corrections of the linear model")
        page.table(
            ["number", "relative change", "standard error"],
            [[c.name, c.relative, c.std_error] for c in d.corrections],
        )
    if d.proof is not None:
        facts = [("nrmse before", d.proof.nrmse_before), ("nrmse after", d.proof.nrmse_after)]
        page.facts([*facts, ("noise alone", d.proof.noise_floor)])
    for line in d.advice:
        page.note(f"Next experiment: {line}")


def _where(page: Page, d: Diagnosis) -> None:
    page.section("Where?")
    if d.place.where:
        depends = ", ".join(d.place.depends_on) or "nothing that varies"
        page.text(f"{d.place.where}; depends on {depends}; component: {d.place.component}.")
    if d.maps_before:
        figure, axes = subplots(rows=1, columns=2, sharey=True)
        draw.mismatch_map(axes[0], d.maps_before[0], "before")
        draw.mismatch_map(axes[1], d.maps_after[0], "after")
        page.figure(
            figure, "Mismatch map",
            "Whitened residual of the first recording, time against frequency; 1 (pale) is noise "
            "alone. What lights up before and not after is what was found.",
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
    if d.free_form:
        page.heading("The rival without a name")
        page.table(
            ["smooth map of", "fitted", "held out"],
            [[f.terms[0].name, f.fitted, f.held_out] for f in d.free_form],
            "Log-likelihood that a free map of these variables would add to the final model.",
        )


def _proof(page: Page, d: Diagnosis) -> None:
    if d.proof is None:
        return
    page.section("Proof on held-out recordings")
    for overlay in d.proof.overlays:
        figure, axes = subplots(rows=2, columns=1, height=4.6, sharex=True)
        draw.overlay(axes[0], overlay, d.plant.output_unit)
        draw.errors(axes[1], overlay, d.plant.output_unit)
        page.figure(
            figure, f"{Path(overlay.name).name}, before and after",
            "Free-running simulation from the recording's own start; nothing was fitted to it. "
            "Below: what is left.",
        )  # fmt: skip
    p = d.proof
    rows = [["y", p.nrmse_before, p.nrmse_after, p.noise_floor]]
    if p.u_nrmse_before is not None:
        rows.append(["u", p.u_nrmse_before, p.u_nrmse_after, p.u_noise_floor])
    low, high = p.interval
    page.table(
        ["signal", "nrmse before", "nrmse after", "noise alone"], rows,
        f"95 % interval of the change in y by paired block bootstrap: {low:.3g} to {high:.3g}.",
    )  # fmt: skip
