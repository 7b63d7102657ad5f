"""What is advised where a map without a name is all that is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.diagnosis import _why_led
from ffl.diagnose.proof.advise import Experiment
from ffl.diagnose.proof.counsel import advice_of
from ffl.diagnose.recorded.where import Place


@pytest.mark.parametrize("said", ["unnamed", "explained"])
def test_a_controller_that_is_not_stated_is_asked_for(stage, said):
    place = Place("plant", "a dependence on position", ("position",))
    held = advice_of(said, place, None, stage)
    free = advice_of(said, place, None, replace(stage, controller=None))
    assert len(held) == (said == "unnamed")
    assert [line for line in free if "as [controller] and record r" in line] == list(free[1:])
    assert len(free) == 2 * len(held)


def test_bursts_are_asked_of_standstill_and_lost_commands_of_the_drive(stage):
    bursts, lost = Place("environment", "bursts", ("time",)), Place("timing", "lost", ("time",))
    (again,) = advice_of("unnamed", bursts, None, stage)
    assert "at standstill" in again
    (again,) = advice_of("unnamed", lost, None, stage)
    assert "the drive received" in again
    entered = Place("environment", "a force: time", ("time",), port="a force")
    assert "at standstill" not in advice_of("unnamed", entered, None, stage)[0]


def between(separation):
    zero = np.zeros(3)
    return Experiment("a wave", zero, zero, zero, ("one", "other"), separation, ())


def test_no_number_is_said_of_a_difference_that_nobody_can_foretell():
    assert "by 37.3 standard" in between(37.3).advice
    assert "more than 100 standard" in between(4.07e13).advice


def test_two_names_for_one_machine_need_no_experiment():
    same = between(0.0017)
    assert same.idle
    assert "either will do" in same.advice
    assert "0.0017" not in same.advice
    assert not between(0.5).idle
    assert "go beyond that range" in between(0.5).advice


def test_open_loop_is_no_fault_and_a_recorded_r_is_not_denied():
    assert "usual in open loop" in _why_led(False)
    assert "r was recorded" in _why_led(True)
    assert "open loop" not in _why_led(True)
