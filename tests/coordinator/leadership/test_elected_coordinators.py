"""Two coordinators on machines of their own, either of which is killed, hangs or is cut off: the robots elect one."""

import re

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


def test_one_leads_at_a_time_no_task_is_lost_or_done_twice_and_equal_seeds_give_equal_elections() -> None:
    """In the second of them two coordinators stand for election at once."""
    with quiet():
        found = {seed: run_elected(seed) for seed in (0, 61)}
        assert [broken for broken, _ in found.values()] == [[], []]
        assert sum(elections for _, elections in found.values()) > 0  # some took over
        assert run_elected(61) == found[61]
