"""A run is a folder of plain files; only the parent process writes, and every file appears whole."""

from __future__ import annotations

import json
import os
import platform
import tomllib
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from ffl.errors import InputError
from ffl.systems.atomic import require_folder, write_text

PACKAGES = ("ffl", "numpy", "scipy", "numba", "cvxpy", "osqp", "h5py")


def versions() -> dict[str, str]:
    """Versions that a number may depend on."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


RESULTS = {"campaign": str, "seed": int, "versions": dict, "runs": list}
RUN = {"name": str, "status": str, "parameters": int, "error_norm": list, "feedforward_norm": list}
RUN |= {"cost": list, "update": list}


def read_results(folder: Path) -> dict[str, Any]:
    """results.json of a run's folder, with every key that `ffl run` writes."""
    path = folder / "results.json"
    try:
        results = json.loads(path.read_text())
    except (FileNotFoundError, NotADirectoryError):
        if (folder / "campaign.toml").is_file():
            raise InputError(f"{folder}: a run that has not ended; {_go_on(folder)}") from None
        raise InputError(f"{folder}: no results.json; give the folder of a run") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not valid JSON ({error}); {_go_on(folder)}") from None
    if not isinstance(results, dict) or results.get("schema") != 1:
        raise InputError(f"{path}: not the results of 'ffl run' (schema 1)")
    _require(results, RESULTS, f"{path}: ")
    for index, run in enumerate(results["runs"]):
        if not isinstance(run, dict):
            raise InputError(f"{path}: runs[{index}] is no table; run the campaign again")
        _require(run, RUN, f"{path}: runs[{index}].")
    return results


def _go_on(folder: Path, what: str = "go on") -> str:
    return f"{what} with: ffl run {folder / 'campaign.toml'} --out {folder} --resume"


def require_runs(folder: Path, results: Mapping[str, Any], names: Sequence[str]) -> None:
    """Raises `InputError` where results.json does not hold the campaign's runs, each once."""
    held = [run["name"] for run in results["runs"]]
    for name in (*names, *held):
        if held.count(name) != names.count(name):
            what = "is missing" if name not in held else "is there twice"
            what = what if name in names else "is not one of campaign.toml"
            raise InputError(
                f"{folder / 'results.json'}: run '{name}' {what}; {_go_on(folder, 'write the file again')}"
            )


def _require(table: Mapping[str, Any], kinds: Mapping[str, type], where: str) -> None:
    for key, kind in kinds.items():
        if not isinstance(table.get(key), kind):
            raise InputError(f"{where}{key} is missing or damaged; run the campaign again")


class Store:
    """The folder of a campaign run: `campaign.toml` and what it needs, one HDF5 file per run,
    `results.json`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._lock: Any = None

    @classmethod
    def open(cls, folder: Path, files: Mapping[str, str], resume: bool) -> Store:
        """Makes or resumes the folder; refuses one that holds something else.

        `files` are the resolved campaign's; a folder made from another campaign is refused, but for one
        of fewer trials: learning goes on.
        """
        require_folder(folder)
        present = [p for p in folder.iterdir() if not _is_rest(p)] if folder.is_dir() else []
        if present and not resume:
            raise InputError(
                f"{folder}: the folder is not empty; add --resume to go on, or give another --out"
            )
        # A kill while the folder was being made leaves some of the campaign's own files, no others.
        whole = all((folder / name).is_file() for name in files)
        if not whole and any(path.name not in files for path in present):
            raise InputError(
                f"{folder}: holds no run of this campaign to resume; give another --out"
            )
        for name, text in files.items():
            path = folder / name
            if path.is_file() and not _goes_on(path.read_text(), text):
                line = _first_difference(path.read_text(), text)
                raise InputError(
                    f"{path}: the campaign has changed since the folder was made ({line}); give "
                    "another --out"
                )
        store = cls(folder)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            store._hold()
            for name, text in files.items():
                if not (folder / name).is_file() or (folder / name).read_text() != text:
                    write_text(folder / name, text)
        except OSError as error:
            raise InputError(f"{folder}: cannot be written: {error.strerror}") from None
        for path in folder.iterdir():
            if path.name.endswith(".part"):
                path.unlink(missing_ok=True)
        return store

    def signals(self, run: str) -> Path:
        return self.folder / f"{run}.h5"

    def write_results(self, results: Mapping[str, Any]) -> None:
        text = json.dumps(results, indent=1, allow_nan=False)
        write_text(self.folder / "results.json", text + "\n")

    def close(self) -> None:
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def _hold(self) -> None:
        """One writer: the lock falls with the process, however it ends."""
        try:
            import fcntl
        except ImportError:  # no advisory locks on this system
            return
        self._lock = open(self.folder / ".lock", "w")  # noqa: SIM115
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._lock.close()
            raise InputError(
                f"{self.folder}: another ffl run writes here; wait for it or give another --out"
            ) from None
        os.set_inheritable(self._lock.fileno(), False)


def _is_rest(path: Path) -> bool:
    """What an interrupted write may leave behind."""
    return path.name == ".lock" or (path.name.startswith(".") and path.name.endswith(".part"))


def _goes_on(old: str, new: str) -> bool:
    """Whether the file `new` is that of `old`, or of the same campaign with more trials."""
    if old == new:
        return True
    try:
        before, after = tomllib.loads(old), tomllib.loads(new)
        fewer = before.pop("trials") <= after.pop("trials")
    except (tomllib.TOMLDecodeError, KeyError, TypeError):
        return False
    return bool(fewer and before == after)


def _first_difference(old: str, new: str) -> str:
    for before, after in zip(old.splitlines(), new.splitlines(), strict=False):
        if before != after:
            return f"was '{before[:60]}', is '{after[:60]}'"
    return "lines were added or taken out"
