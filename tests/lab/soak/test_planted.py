"""Each planted bug is found, and what finds it finds nothing in the product as it is."""

import pytest

from robrain.lab.soak.script_drawing import draw_script
from robrain.lab.soak.soaking import SoakTask, soak_one
from robrain.lab.soak.trial import run_trial
from robrain.lab.sweep.run_outcome import RunState
from tests.lab.soak.planted import planted

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("impatient")]


@pytest.mark.parametrize(("bug", "seed"), [("lease_not_kept", 3), ("journal_late", 1), ("cancelled_forgotten", 17)])
def test_a_planted_bug_is_found_by_the_seed_in_the_docs(bug, seed):
    with planted(bug):
        record = soak_one(SoakTask(seed=seed, trials_max=0))
    assert record.state is RunState.DONE
    assert record.verdict.broken
    assert record.cpu_s > 0
    assert run_trial(draw_script(seed)).broken == ()


def test_a_script_that_finds_a_planted_bug_is_shrunk_and_fails_by_itself():
    with planted("halt_forgotten"):
        record = soak_one(SoakTask(seed=11, trials_max=6))
    script = draw_script(11)
    assert len(record.script.faults) < len(script.faults)
    assert len(record.script.tasks) < len(script.tasks)
    with planted("halt_forgotten"):
        assert run_trial(record.script).broken[0].invariant is record.verdict.broken[0].invariant
    assert run_trial(record.script).broken == ()
