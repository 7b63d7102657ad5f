"""docs/plants.md: its example loads and is a sound plant."""

import re
from pathlib import Path

from ffl.effects import EFFECTS
from ffl.systems.plant_file import load_plant

TEXT = (Path(__file__).resolve().parents[2] / "docs" / "plants.md").read_text()


def test_the_example_is_a_sound_plant(tmp_path):
    path = tmp_path / "belt.toml"
    path.write_text(re.search(r"```toml\n(.*?)```", TEXT, re.S)[1])
    plant = load_plant(path)
    assert plant.require_stable().is_stable
    assert EFFECTS[plant.effects[0].name].check(plant.effects[0])["level"] == 3.0
