"""False alarms of the diagnosis on recordings in which nothing is missing.

Cheap cases of the independent generator (`ffl.challenge.null_case`: several loops, noises and
trajectories, mass up to 0.6 % off); anything but `nothing_missing` or `inconclusive` is an alarm.

    python benchmarks/false_alarms.py [--count 1000] [--seed 1] [--jobs 2] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections import Counter
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from _cases import read_case
from joblib import Parallel, delayed

from ffl.challenge import null_case
from ffl.challenge.tally import Share
from ffl.diagnose import diagnose
from ffl.errors import InputError

RIGHT = ("nothing_missing", "inconclusive")


def one(seed: int, k: int) -> dict:
    """Machine, verdict, what was named, and CPU seconds of null case `k`."""
    case = null_case(k, seed)
    with tempfile.TemporaryDirectory() as folder:
        case.save(folder)
        plant, fit, validate = read_case(Path(folder))
    start = time.process_time()
    try:
        answer = diagnose(plant, fit, validate, rng=np.random.default_rng(k)).answer()
        verdict, names = answer["verdict"], [e["name"] for e in answer["effects"]]
    except InputError as error:
        verdict, names = f"refused: {error}", []
    seconds = time.process_time() - start
    return {"case": k, "machine": case.machine, "verdict": verdict, "names": names, "cpu": seconds}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args()
    work = (delayed(one)(chosen.seed, k) for k in range(chosen.count))
    rows = Parallel(n_jobs=chosen.jobs, verbose=0 if chosen.json else 5)(work)
    alarms = [row for row in rows if row["verdict"] not in RIGHT]
    share = Share(len(alarms), len(rows))
    low, high = share.interval
    found = {
        "false_alarms": len(alarms),
        "cases": len(rows),
        "share": len(alarms) / len(rows),
        "interval_95": [low, high],
        "verdicts": dict(Counter(row["verdict"] for row in rows)),
        "alarms_by_machine": dict(Counter(row["machine"] for row in alarms)),
        "alarms": [{key: row[key] for key in ("case", "machine", "names")} for row in alarms],
        "cpu_seconds_per_case": float(np.mean([row["cpu"] for row in rows])),
    }
    if chosen.json:
        print(json.dumps(found, indent=2))
        return
    for key, value in found.items():
        print(f"{key:24} {value}")


if __name__ == "__main__":
    main()
