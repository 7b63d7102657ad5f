"""The real recordings of reports/real_recordings.md, diagnosed anew by the shipped command line.

    python benchmarks/real_recordings.py [NAME...] [--keep DIR] [--pictures reports] [--json]

The data are looked for in FFL_DATA, else in ../shared/data. Each recording is one `ffl diagnose` in a
process of its own, one after the other. An answer that stands in `--keep` is not computed again.
`--pictures` draws every picture whose recordings are among those chosen.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from _real_pictures import draw_all
from _recordings import CASES, KNOWN, ROOT, Case

from ffl.errors import InputError


def one(case: Case, folder: Path) -> dict[str, Any]:
    """The answer in `folder`, computed where it does not stand there yet, as a row of the table."""
    spent, answer = folder / "spent.json", folder / "answer.json"
    if not (spent.exists() and answer.exists()):
        command = [sys.executable, "-m", "ffl.cli", *case.arguments(folder)]
        before, began = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime, time.perf_counter()
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
        if done.returncode:
            raise InputError(f"{case.name}: {done.stderr.strip()}")
        user = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
        took = {"user": round(user, 1), "wall": round(time.perf_counter() - began, 1)}
        spent.write_text(json.dumps(took))
    return (
        {"name": case.name} | row_of(json.loads(answer.read_text())) | json.loads(spent.read_text())
    )


def row_of(answer: dict[str, Any]) -> dict[str, Any]:
    """What the table shows of answer.json."""
    row = {
        "verdict": answer["verdict"],
        "names": {e["name"]: round(e["confidence"], 2) for e in answer["effects"]},
    }
    for key, figure in (("nrmse", "nrmse"), ("nrmse_of_command", "u_nrmse")):
        both = [
            answer.get("validation", {}).get(f"{figure}_{when}") for when in ("before", "after")
        ]
        if None not in both:
            row[key] = [float(f"{value:.4g}") for value in both]
    between = answer.get("transmission")
    if between is None:
        return row
    terms = {term["name"]: term["says"] for term in between["terms"]}
    return row | {"between_encoders": terms, "explained": round(between["explained_held_out"], 5)}


def print_row(row: dict[str, Any]) -> None:
    """One line of figures, below it the names, below them what the second encoder tells."""
    before, after = row.get("nrmse", (np.nan, np.nan))  # none where nothing could be judged
    print(
        f"{row['name']:11} {row['verdict']:16} {before:9.4g} -> {after:<9.4g} "
        f"{row['user']:6.1f} s user {row['wall']:6.1f} s wall"
    )
    print("   ", ", ".join(f"{n} {p:.2f}" for n, p in row["names"].items()) or "nothing named")
    if "nrmse_of_command" in row:
        print("    nrmse of the command: {:.4g} -> {:.4g}".format(*row["nrmse_of_command"]))
    for name, says in row.get("between_encoders", {}).items():
        print(f"    between the encoders, {name}: {says}")
    if "explained" in row:
        print(f"    of their difference, held out: {100 * row['explained']:.2f} % explained")
    sys.stdout.flush()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--keep", type=Path, help="folder for the answers")
    parser.add_argument("--pictures", type=Path, help="folder to draw to")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    unknown = [name for name in options.names if name not in KNOWN]
    if unknown:
        print(f"no recording '{unknown[0]}'; known: {', '.join(KNOWN)}", file=sys.stderr)
        return 2
    chosen = [KNOWN[name] for name in options.names] or list(CASES)
    with tempfile.TemporaryDirectory() as home:
        keep = (options.keep or Path(home)).resolve()
        rows = []
        try:
            for case in chosen:
                rows.append(one(case, keep / case.name))
                if not options.json:
                    print_row(rows[-1])
            if options.pictures:
                draw_all({case.name for case in chosen}, keep, options.pictures)
        except InputError as error:
            print(error, file=sys.stderr)
            return 2
    if options.json:
        print(json.dumps(rows, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
