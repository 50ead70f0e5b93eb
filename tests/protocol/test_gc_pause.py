"""The garbage collector belongs to the whole process: runs leave it as they found it."""

import gc
import weakref

import pytest

from robrain.protocol.gc_pause import GcPause
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.scenarios.scenario import Scenario


@pytest.fixture(autouse=True)
def usual():
    usual = gc.get_threshold()
    yield usual
    assert gc.get_threshold() == usual


class Ring:
    def __init__(self):
        self.itself = self


@pytest.mark.slow
def test_the_last_of_several_lets_the_collector_go(usual):
    first, second = GcPause(), GcPause()
    first.release()
    first.release()
    assert gc.get_threshold() != usual
    second.release()
    assert gc.get_threshold() == usual


@pytest.mark.slow
def test_cycles_that_a_run_leaves_are_collected_during_it_and_after_it():
    before = weakref.ref(Ring())
    calm = GcPause()
    assert before() is None
    during = weakref.ref(Ring())
    gc.collect()
    assert during() is None
    kept = Ring()
    old, calm_again = weakref.ref(kept), GcPause()
    del kept
    gc.collect()
    assert old() is not None  # it was there before
    calm.release()
    calm_again.release()
    assert old() is None


@pytest.mark.slow
def test_a_run_that_ends_or_fails_gives_the_collector_back(usual, tmp_path):
    run = LockstepRun(Scenario.builtin("arena_small").world())
    assert gc.get_threshold() != usual
    run.close()
    assert gc.get_threshold() == usual
    assert gc.get_freeze_count() == 0
