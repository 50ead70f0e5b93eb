"""Scripts of a soak with a coordinator that stands by: what was acknowledged survives the coordinator's disk.

`python -m tests.sim.stand_in.test_copied_journal_in_soaks` runs a hundred, for `make soak`; the test runs a few.
"""

import re

import pytest

from robrain.coordinator.standing.stand_by import Following, StandBy
from robrain.protocol.clock import to_ns
from robrain.sim.faults.fault_spec import COORDINATOR, FaultKind, FaultSpec
from robrain.sim.faults.kept_journal import JournalDisk
from robrain.sim.faults.process import Process
from robrain.sim.stand_in.judge import Judge, TeamRule
from robrain.sim.stand_in.script_drawing import draw_script
from robrain.sim.stand_in.stand_in_run import StandInRun
from robrain.sim.stand_in.trial import quiet

pytestmark = pytest.mark.slow

OTHER = "stand_by"
KILL = FaultSpec(robot=COORDINATOR, kind=FaultKind.KILL, at_s=0.0, until_s=1.0)
JUDGED = {TeamRule.LOST, TeamRule.DONE_TWICE, TeamRule.TWO_AT_ONCE}
SAME_END = re.compile(r"has ended as (\w+), and again as \1$")
"""The end of a task is published before the copy has it: a coordinator on the copy may note the same end once more."""
NUMBER = 1_000_000


def run_with_stand_by(seed: int) -> tuple[list, bool]:
    """What does not hold, and whether a coordinator went on from the copy."""
    run = StandInRun(draw_script(seed))
    judge = Judge(run)
    disk = JournalDisk()

    def start(process: Process) -> StandBy:
        return StandBy(run._endpoint(process), disk.open(), OTHER)

    other = Process(OTHER, run.clock, run.exchange, start)
    other.start()
    has_led = False
    while not judge.is_over:
        run.tick()
        if other.component is not None:
            other.step(run.now_ns)
            feed = run.coordinator.feed if run.coordinator is not None else None
            is_in_step = other.component.following(run.now_ns) is Following.IN_STEP
            if is_in_step and feed is not None and feed.stand_by and run.now_ns > to_ns(5.0 + seed % 40):
                # The coordinator's machine is gone, with its disk; the operator starts one on the copy.
                has_led = True
                run.disk.pull()
                run.processes[COORDINATOR].set(NUMBER, KILL, begins=True)
                run.exchange.drop(OTHER)
                disk.pull()
                other.component, run.disk = None, disk
                run.processes[COORDINATOR].set(NUMBER, KILL, begins=False)
        judge.step()
    broken = [one for one in judge.finish() if one.invariant in JUDGED and not SAME_END.search(one.what)]
    run.close()
    return broken, has_led


def check(scripts: int) -> None:
    led = 0
    with quiet():
        for seed in range(scripts):
            broken, has_led = run_with_stand_by(seed)
            assert broken == [], seed
            led += has_led
    assert led >= 0.6 * scripts


def test_no_task_is_lost_or_done_twice_when_a_coordinator_goes_on_from_the_copy() -> None:
    check(5)


if __name__ == "__main__":
    check(100)
