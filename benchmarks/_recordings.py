"""The real recordings of reports/real_recordings.md: what each is diagnosed by."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ffl.campaign.reference import find_recording

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Case:
    """One `ffl diagnose`: a plant and a map by the names they are shipped under, recordings by their
    place in the data folder; without `judge` the last 30 % of `fit` do."""

    name: str
    plant: str
    mapping: str
    fit: tuple[str, ...]
    judge: tuple[str, ...] = ()

    def arguments(self, out: Path) -> list[str]:
        return [
            "diagnose", "--model", f"plants/{self.plant}.toml", *map(found, self.fit),
            *(part for file in self.judge for part in ("--validate", found(file))),
            "--map", self.mapping, "--out", str(out), "--quiet",
        ]  # fmt: skip


def found(file: str) -> str:
    """The path of a recording of the data folder; raises `InputError`."""
    return str(find_recording(file, ROOT).absolute())


UNIFORM, TANKS = "ced/DATAUNIF.csv", "cascaded_tanks/dataBenchmark.csv"
SILVERBOX, KUKA = "silverbox/SNLS80mV.mat", "kuka_kr300/FF_A_08ms.mat"
CASES = (
    Case("emps", "emps", "emps", ("emps/DATA_EMPS.mat",), ("emps/DATA_EMPS_PULSES.mat",)),
    Case("silverbox", "silverbox_linear", "silverbox", (f"{SILVERBOX}::multisine",),
         (f"{SILVERBOX}::arrow",)),
    Case("ced", "ced_linear", "ced_uniform", (f"{UNIFORM}::estimation_1", f"{UNIFORM}::estimation_2"),
         (f"{UNIFORM}::test_1", f"{UNIFORM}::test_2")),
    Case("tanks", "tanks_linear", "cascaded_tanks", (f"{TANKS}::estimation",), (f"{TANKS}::test",)),
    *(Case(f"kuka{k}", f"kuka_axis{k}", f"kuka_axis{k}", (f"{KUKA}::motor" if k < 4 else KUKA,))
      for k in range(1, 7)),
    *(Case(f"kuka{k}_both", f"kuka_axis{k}", f"kuka_axis{k}", (f"{KUKA}::both",))
      for k in range(1, 4)),
)  # fmt: skip
KNOWN = {case.name: case for case in CASES}
