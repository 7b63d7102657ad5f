"""Commitments: hashes of every truth and every recording, published before anybody solves."""

from __future__ import annotations

import hashlib
import json
import secrets
from pathlib import Path

from ffl.errors import InputError
from ffl.systems.atomic import write_text

FILE = "commitments.json"


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _read(path: Path) -> dict:
    try:
        found = json.loads(path.read_text())
    except ValueError:
        found = None
    if not isinstance(found, dict):
        raise InputError(f"{path}: not valid JSON; give the file as 'ffl challenge make' wrote it")
    return found


def _folder_hash(folder: Path) -> str:
    total = hashlib.sha256()
    for path in sorted(folder.iterdir()):
        total.update(path.name.encode() + b"\0" + path.read_bytes())
    return total.hexdigest()


SEED = "challenge.seed"


def begin(truths: Path, seed: int, fraction: float) -> None:
    """Seal what all cases follow from in `truths/challenge.seed`, beside a salt, before the first one.

    Raises InputError where `truths` was begun with another seed or fraction: its cases would be
    published under a seed that is not theirs.
    """
    sealed, plan = truths / SEED, {"seed": seed, "fraction": fraction}
    if sealed.is_file():
        begun = _read(sealed)
        if {key: begun.get(key) for key in plan} != plan:
            raise InputError(
                f"{sealed}: this challenge was begun with another seed or fraction; give those, or "
                "empty folders"
            )
        return
    if any(truths.glob("*.json")):
        raise InputError(f"{truths}: holds truths but no {SEED}; give an empty folder")
    write_text(sealed, json.dumps({**plan, "salt": secrets.token_hex(32)}) + "\n")


def commit(cases: Path, truths: Path, about: dict) -> dict:
    """Write `cases/commitments.json`. Truth files carry a random salt, so a hash tells nothing.

    `root` is one hash over all of them: the number to publish. The seed is committed to as well, by
    the hash of what `begin` sealed.
    """
    entries = {}
    for path in sorted(truths.glob("*.json")):
        name = path.stem
        entries[name] = {"truth": _hash(path), "case": _folder_hash(cases / name)}
    text = json.dumps(entries, sort_keys=True)
    root = hashlib.sha256(text.encode()).hexdigest()
    about = {**about, "seed_hash": _hash(truths / SEED)}
    document = {"schema": 1, "root": root, **about, "cases": entries}
    write_text(cases / FILE, json.dumps(document, indent=1, sort_keys=True) + "\n")
    return document


def open_truths(cases: Path, truths: Path) -> tuple[dict[str, dict], dict]:
    """Truths by case name and the commitments, after every hash has been compared.

    Raises InputError where a truth or a recording is not the one that was committed to.
    """
    path = cases / FILE
    if not path.is_file():
        raise InputError(f"{path}: no commitments; make the challenge first")
    document = _read(path)
    if {"root", "cases", "seed_hash", "fraction"} - document.keys():
        raise InputError(f"{path}: not the commitments of 'ffl challenge make'; give its folder")
    text = json.dumps(document["cases"], sort_keys=True)
    if hashlib.sha256(text.encode()).hexdigest() != document["root"]:
        raise InputError(f"{path}: the list of hashes does not have the published root hash")
    opened = {}
    for name, entry in document["cases"].items():
        truth = truths / f"{name}.json"
        if not truth.is_file():
            raise InputError(f"{truth}: the truth of case {name} is missing")
        if _hash(truth) != entry["truth"]:
            raise InputError(f"{truth}: this is not the truth that was committed to (SHA-256)")
        if _folder_hash(cases / name) != entry["case"]:
            raise InputError(f"{cases / name}: files differ from those committed to (SHA-256)")
        opened[name] = json.loads(truth.read_text())
    sealed = truths / SEED
    if not sealed.is_file() or _hash(sealed) != document["seed_hash"]:
        raise InputError(f"{sealed}: this is not the seed that was committed to (SHA-256)")
    return opened, {**document, "seed": json.loads(sealed.read_text())["seed"]}
