"""The house rules that a machine can check: import order, who may name what, file sizes."""

import ast
import re
from pathlib import Path

import pytest

from ffl.effects import EFFECTS

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "ffl"
ORDER = [
    "errors",
    "systems",
    "recordings",
    "effects",
    "bases",
    "machines",
    "learn",
    "identify",
    "diagnose",
    "challenge",
    "campaign",
    "report",
    "cli",
]
FILES = sorted(PACKAGE.rglob("*.py"))


def imported(path):
    """Modules named in every import of a file, also inside functions."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            yield node.module


def layer(path):
    part = path.relative_to(PACKAGE).parts[0]
    return part.removesuffix(".py")


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_run_down_the_list_only(path):
    own = layer(path)
    if own == "__init__":
        return
    for module in imported(path):
        parts = module.split(".")
        if parts[0] == "ffl" and len(parts) > 1:
            assert ORDER.index(parts[1]) <= ORDER.index(own), f"{own} imports {module}"


def test_the_challenge_shares_no_simulation_code():
    for path in (PACKAGE / "challenge").rglob("*.py"):
        for module in imported(path):
            assert not re.match(r"ffl\.(machines|effects)", module), f"{path.name} imports {module}"


@pytest.mark.parametrize(
    ("library", "homes"),
    [
        ("cvxpy", {"learn/convex.py"}),
        ("osqp", set()),
        ("matplotlib", {"report"}),
        ("typer", {"cli.py", "cli"}),
        ("jinja2", {"report"}),
    ],
)
def test_a_library_is_named_only_where_it_lives(library, homes):
    for path in FILES:
        place = path.relative_to(PACKAGE)
        if any(module.split(".")[0] == library for module in imported(path)):
            assert place.as_posix() in homes or place.parts[0] in homes, place


def test_files_stay_readable():
    long = {
        str(p.relative_to(ROOT)): n for p in FILES if (n := len(p.read_text().splitlines())) > 400
    }
    assert not long


@pytest.mark.parametrize(
    "page", sorted(p for p in ROOT.rglob("*.md") if ".venv" not in p.parts), ids=lambda p: p.name
)
def test_every_link_of_a_page_leads_somewhere(page):
    for target in re.findall(r"\]\(([^)#\s]+)", page.read_text()):
        if not target.startswith(("http:", "https:")):
            assert (page.parent / target).exists(), f"{page.name} names {target}"


def test_every_effect_has_its_line_in_the_documentation():
    lines = (ROOT / "docs" / "effects.md").read_text().splitlines()
    table = {line.split("`")[1]: line for line in lines if line.startswith("| `")}
    assert set(table) == set(EFFECTS)
    for name, effect in EFFECTS.items():
        assert all(f"`{p.name}`" in table[name] for p in effect.parameters), name
