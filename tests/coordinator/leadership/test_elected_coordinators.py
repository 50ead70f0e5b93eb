"""Two coordinators on machines of their own, either of which is killed, hangs or is cut off: the robots elect one."""

import re
from functools import cache

import msgspec
import pytest

from robrain.lab.soak.judge import Broken, Judge, TeamRule
from robrain.lab.soak.script_drawing import draw_script
from robrain.lab.soak.soak_run import quiet
from robrain.sim.faults.fault_spec import FaultKind
from tests.coordinator.leadership.elected_team import ElectedRun, faults_of_sites

pytestmark = pytest.mark.slow

JUDGED = {TeamRule.LOST, TeamRule.DONE_TWICE, TeamRule.TWO_AT_ONCE, TeamRule.UNSETTLED, TeamRule.FAILED}
SAME_END = re.compile(r"has ended as (\w+), and again as \1$")
"""The end of a task is published before the copy has it: the next coordinator may note the same end once more."""
OF_PROCESSES = (FaultKind.KILL, FaultKind.HANG, FaultKind.PARTITION)


@cache
def run_elected(seed: int) -> tuple[list[Broken], int]:
    """What does not hold, and how many elections coordinators that stood by have won.

    Robots that are killed come back, as two witnesses that are gone for good leave no majority of three.
    """
    script = draw_script(seed)
    robots = [robot.name for robot in script.robots]
    faults = [
        fault
        for fault in script.faults
        if (fault.robot in robots or fault.kind not in OF_PROCESSES)
        and not (fault.kind is FaultKind.KILL and fault.until_s is None)
    ]
    script = msgspec.structs.replace(script, faults=tuple(faults), consensus=False)
    run = ElectedRun(script, faults_of_sites(seed, robots))
    judge = Judge(run)
    while not judge.is_over:
        run.tick()
        judge.step()
        leading = run.leading()
        assert len(leading) < 2, f"seed {seed}: {leading} lead at {run.now_ns}"
    broken = [one for one in judge.finish() if one.invariant in JUDGED and not SAME_END.search(one.what)]
    run.close()
    return broken, len(run.elections)


def test_one_leads_at_a_time_and_no_task_is_lost_or_done_twice() -> None:
    won = 0
    with quiet():
        for seed in range(2):
            broken, elections = run_elected(seed)
            assert broken == [], seed
            won += elections
    assert won > 0  # some took over


@pytest.mark.parametrize("seed", [61, 73])
def test_two_that_stand_at_once_do_not_keep_each_other_from_being_elected(seed: int) -> None:
    with quiet():
        assert run_elected(seed)[0] == []


def test_equal_seeds_equal_elections() -> None:
    with quiet():
        assert run_elected(61) == run_elected.__wrapped__(61)
