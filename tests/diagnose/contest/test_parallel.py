import threading

import numpy as np
import pytest

from ffl.diagnose.contest import parallel
from ffl.diagnose.contest.parallel import each


def test_keeps_the_order_and_shares_out_what_is_shared_out_within():
    def product(a: int) -> int:
        return sum(each(lambda b: a * b, range(a)))

    assert each(product, range(40)) == [a * (a * (a - 1) // 2) for a in range(40)]
    assert each(product, []) == []


def test_another_thread_takes_part():
    both = threading.Barrier(2, timeout=60.0)  # passed only where two are at work at once
    assert each(lambda _: both.wait() >= 0, range(2)) == [True, True]


def test_work_that_threads_only_take_turns_at_is_left_to_one():
    """Python alone holds the interpreter; a wait does not, and is no work either."""
    seen: list[int] = []

    def turns(k: int) -> int:
        seen.append(threading.get_ident())
        return sum(j * j for j in range(20000)) + k

    for _ in range(3):
        each(turns, range(20))
    seen.clear()
    assert each(turns, range(20)) == [turns(k) for k in range(20)]
    assert set(seen) == {threading.get_ident()}


def test_what_was_left_to_one_is_shared_out_again_after_a_while():
    seen: list[int] = []
    both: list[threading.Barrier] = []

    def work(k: int) -> int:
        seen.append(threading.get_ident())
        if both:
            both[0].wait()
        return k

    parallel._RESTS[work.__code__] = 2
    for _ in range(2):
        assert each(work, range(4)) == [0, 1, 2, 3]
    assert set(seen) == {threading.get_ident()}
    both.append(threading.Barrier(2, timeout=60.0))  # passed only where two are at work at once
    assert each(work, range(2)) == [0, 1]


@pytest.mark.parametrize("bad", [0, 7, 19])
def test_an_exception_comes_through_and_ends_the_work(bad):
    def work(k: int) -> int:
        if k == bad:
            raise ValueError(f"piece {k}")
        return k

    with pytest.raises(ValueError, match=f"piece {bad}"):
        each(work, range(20))
    assert each(work, range(20, 23)) == [20, 21, 22]


def test_numpys_error_state_holds_for_every_piece():
    with np.errstate(over="ignore"):
        assert each(lambda x: np.float64(x) * 1e300, [1e300] * 6) == [np.inf] * 6
