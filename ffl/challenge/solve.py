"""`ffl challenge solve`: the shipped diagnosis on every case, resumable, one process per core."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from ffl.errors import InputError
from ffl.recordings import READERS
from ffl.systems.atomic import require_folder, write_text

# A note beside a case may be text; a recording among them is not.
RECORDINGS = frozenset(READERS) - {".txt", ".dat", ".asc"}


@dataclass(frozen=True)
class CaseFiles:
    """The files of one case: plant file, recordings to fit and to judge, optional name map."""

    name: str
    plant: Path
    fit: tuple[Path, ...]
    validate: tuple[Path, ...]
    mapping: Path | None = None


Solver = Callable[[CaseFiles, Path], dict]


def find_cases(folder: Path | str) -> list[CaseFiles]:
    """Cases below a folder: subfolders with plant.toml, fit_* and validate_* (and map.toml).

    Raises InputError where there is none, or one without a recording to fit.
    """
    root = Path(folder)
    found = []
    for plant in sorted(root.glob("*/plant.toml")):
        home = plant.parent
        fit, judge = (
            tuple(p for p in sorted(home.glob(f"{kind}_*")) if p.suffix.lower() in RECORDINGS)
            for kind in ("fit", "validate")
        )
        if not fit:
            raise InputError(f"{home}: no fit_* recording beside plant.toml")
        mapping = home / "map.toml"
        found.append(
            CaseFiles(home.name, plant, fit, judge, mapping if mapping.is_file() else None)
        )
    if not found:
        raise InputError(f"{root}: no case (a subfolder with plant.toml and fit_*.csv)")
    return found


def shipped_diagnosis(limit: float = 600.0, command: Sequence[str] | None = None) -> Solver:
    """Solver that runs `ffl diagnose --model ... --validate ... --out ... --json` as a user would.

    Exit code 2 becomes the verdict "refused" with its line, any other failure or more than
    `limit` seconds the verdict "failed".
    """
    start = list(command or (sys.executable, "-c", "from ffl.cli import main; main()"))

    def run(case: CaseFiles, out: Path) -> dict:
        words = [*start, "diagnose", "--model", str(case.plant), *map(str, case.fit)]
        for path in case.validate:
            words += ["--validate", str(path)]
        if case.mapping is not None:
            words += ["--map", str(case.mapping)]
        words += ["--out", str(out), "--json"]
        # One thread per process: the jobs share the cores, not each other's.
        quiet = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1")
        process = subprocess.Popen(
            words,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, **quiet},
            start_new_session=True,
        )
        try:
            stdout, stderr = process.communicate(timeout=limit)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return {"schema": 1, "verdict": "failed", "message": f"more than {limit:g} s"}
        except BaseException:
            os.killpg(process.pid, signal.SIGKILL)
            raise
        last = (stderr.strip().splitlines() or [""])[-1]
        if process.returncode == 2:
            return {"schema": 1, "verdict": "refused", "message": last}
        if process.returncode != 0:
            return {"schema": 1, "verdict": "failed", "message": last}
        try:
            return json.loads(stdout)
        except json.JSONDecodeError:
            return {"schema": 1, "verdict": "failed", "message": "stdout is not JSON"}

    return run


def _solve_one(case: CaseFiles, out: Path, solver: Solver) -> None:
    folder = out / case.name
    folder.mkdir(parents=True, exist_ok=True)
    begin = time.perf_counter()
    try:
        answer = solver(case, folder)
    except Exception as error:  # a solver that breaks is an answer that is wrong, not the end
        answer = {
            "schema": 1,
            "verdict": "failed",
            "message": f"{type(error).__name__}: {error}",
        }
    record = {"seconds": time.perf_counter() - begin, "answer": answer}
    if not (folder / "answer.json").is_file():
        write_text(folder / "answer.json", json.dumps(answer, indent=1, sort_keys=True) + "\n")
    write_text(folder / "solved.json", json.dumps(record, indent=1, sort_keys=True) + "\n")


def solve(
    cases_dir: Path | str,
    out_dir: Path | str,
    jobs: int = 1,
    solver: Solver | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Answer every case that has no answer yet; returns how many were answered now.

    Writes `out_dir/CASE/answer.json`, and `solved.json` ({"seconds", "answer"}) when a case is done
    and never before, beside what the diagnosis itself leaves there. The default solver is the
    shipped command, each case in a process of its own; a callable is run in `jobs` threads.
    """
    if jobs < 1:
        raise InputError(f"jobs = {jobs} must be at least 1")
    cases, out = find_cases(cases_dir), Path(out_dir)
    require_folder(out)
    todo = [c for c in cases if not (out / c.name / "solved.json").is_file()]
    run = solver or shipped_diagnosis()
    out.mkdir(parents=True, exist_ok=True)

    def work(case: CaseFiles) -> None:
        _solve_one(case, out, run)

    with ThreadPoolExecutor(jobs) as pool:
        for k, _ in enumerate(pool.map(work, todo)):
            if progress is not None:
                progress(k + 1, len(todo))
    return len(todo)


def read_answers(out_dir: Path | str) -> dict[str, dict]:
    """Solved records ({"seconds", "answer"}) by case name.

    An `answer.json` alone (an answer made elsewhere) counts as a record without seconds.
    """
    found = {}
    for folder in sorted(p for p in Path(out_dir).iterdir() if p.is_dir()):
        record, answer = folder / "solved.json", folder / "answer.json"
        if record.is_file():
            found[folder.name] = json.loads(record.read_text())
        elif answer.is_file():
            found[folder.name] = {"answer": json.loads(answer.read_text())}
    return found
