"""Each planted bug is found, and what finds it finds nothing in the product as it is."""

import pytest

from robrain.lab.soak.script_drawing import draw_script
from robrain.lab.soak.soaking import SoakTask, soak_one
from robrain.lab.soak.trial import run_trial
from robrain.lab.sweep.run_outcome import RunState
from tests.lab.soak.planted import BUGS, planted

FOUND_BY = {
    "epoch_not_raised": 3,
    "lease_not_kept": 3,
    "journal_late": 1,
    "requeued_without_order": 1,
    "any_report_counts": 3,
    "halt_forgotten": 11,
    "offer_never_free": 10,
    "strays_stay": 5,
    "backoff_without_end": 11,
    "cancelled_forgotten": 17,
}
"""A seed that finds each; docs/how-to/soak.md has the same."""
SHRUNK = "halt_forgotten"
"""Is found by the test that shrinks its script."""


pytestmark = pytest.mark.usefixtures("impatient")


@pytest.mark.slow
@pytest.mark.parametrize("bug", [bug for bug in BUGS if bug != SHRUNK])
def test_a_planted_bug_is_found_by_the_seed_in_the_docs(bug):
    with planted(bug):
        record = soak_one(SoakTask(seed=FOUND_BY[bug], trials_max=0))
    assert record.state is RunState.DONE
    assert record.verdict.broken
    assert record.cpu_s > 0


@pytest.mark.slow
def test_the_seeds_that_find_planted_bugs_find_nothing_in_the_product():
    assert {seed: run_trial(draw_script(seed)).broken for seed in set(FOUND_BY.values())} == dict.fromkeys(
        FOUND_BY.values(), ()
    )


@pytest.mark.slow
def test_a_script_that_finds_a_planted_bug_is_shrunk_and_fails_by_itself():
    with planted(SHRUNK):
        record = soak_one(SoakTask(seed=FOUND_BY[SHRUNK], trials_max=6))
    script = draw_script(FOUND_BY[SHRUNK])
    assert len(record.script.faults) < len(script.faults)
    assert len(record.script.tasks) < len(script.tasks)
    with planted(SHRUNK):
        assert run_trial(record.script).broken[0].invariant is record.verdict.broken[0].invariant
    assert run_trial(record.script).broken == ()
