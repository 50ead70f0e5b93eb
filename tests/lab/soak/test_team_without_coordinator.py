"""Robots whose coordinator is gone: what is left is done once each, on ways that get shorter."""

from collections import Counter

import msgspec
import numpy as np
import pytest

from robrain.agent.consensus import consensus
from robrain.lab.soak.fault_script import FaultScript, ScriptRobot, TaskInput
from robrain.lab.soak.script_drawing import draw_script
from robrain.lab.soak.soak_run import SoakRun, quiet
from robrain.lab.soak.trial import run_trial
from robrain.protocol.clock import to_seconds
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from robrain.sim.faults.fault_spec import COORDINATOR, FaultKind, FaultSpec

pytestmark = pytest.mark.slow

KILLED_S, NEVER_S = 2.0, 2000.0


def orphaned(seed, robots=5, tasks=30, loss=0.0):
    """Tasks all over a floor of 20 × 20 m, most of them nobody's when the coordinator ends."""
    rng = np.random.default_rng(seed)

    def place():
        x_m, y_m = rng.uniform(0.0, 20.0, 2).tolist()
        return Point2D(round(x_m, 1), round(y_m, 1))

    names = [f"r{number + 1}" for number in range(robots)]
    faults = [FaultSpec(robot=COORDINATOR, kind=FaultKind.KILL, at_s=KILLED_S, until_s=NEVER_S)]
    for name in names if loss else ():
        faults.append(FaultSpec(robot=name, kind=FaultKind.LOSE, at_s=KILLED_S, until_s=NEVER_S, share=loss))
    return FaultScript(
        seed=seed,
        consensus=True,
        robots=tuple(ScriptRobot(name=name, place=place()) for name in names),
        chargers=(Point2D(0.0, 0.0), Point2D(20.0, 20.0)),
        tasks=tuple(
            TaskInput(at_s=0.5, task=Task(id=f"t{number:02}", kind="visit", place=place(), service_s=2.0))
            for number in range(tasks)
        ),
        faults=tuple(faults),
    )


class Done:
    """How a run went, until all was done."""

    def __init__(self, script):
        self.driven_m = 0.0
        self.begun = Counter()
        self.rounds = dict.fromkeys((robot.name for robot in script.robots), 0)
        ends, at = set(), {}
        with quiet():
            run = SoakRun(script)
            while len(ends) < len(script.tasks) and to_seconds(run.now_ns) < 200.0:
                run.tick()
                for name, robot in run.robots.items():
                    self.driven_m += robot.forward_m
                    task = run.work(name)
                    if task != at.get(name):
                        at[name] = task
                        self.begun[task] += task.startswith("t")
                    desk = run.host(name)
                    facts = desk.desk.facts
                    ends |= {one.id for one in (facts.task, facts.before) if one is not None and one.state == "done"}
                    self.rounds[name] = max(self.rounds[name], desk.extensions["consensus"]._negotiation.round)
                ends = {task for task in ends if task.startswith("t")}
            self.took_s = to_seconds(run.now_ns)
            run.close()
        self.begun = {task: count for task, count in self.begun.items() if count}


def test_rounds_end_while_robots_work_and_each_task_is_begun_once():
    script = orphaned(3, loss=0.2)
    done = Done(script)
    assert done.begun == dict.fromkeys((order.task.id for order in script.tasks), 1)
    assert set(done.rounds.values()) == {consensus.ROUNDS + 1}
    assert done.took_s < 90.0


def test_rounds_save_ways_of_robots_that_run(monkeypatch):
    ways = []
    for rounds in (0, consensus.ROUNDS):
        monkeypatch.setattr(consensus, "ROUNDS", rounds)
        ways.append(sum(Done(orphaned(seed)).driven_m for seed in (17, 18)))
    assert ways[1] < 0.97 * ways[0]


@pytest.mark.parametrize("seed", [10, 50])
def test_a_robot_that_was_cut_off_when_a_task_ended_does_not_do_it_again(seed):
    """In these drawn scripts it was told of the end by nobody, and then the coordinator ended."""
    script = msgspec.structs.replace(draw_script(seed), consensus=True)
    assert run_trial(script).broken == ()


@pytest.mark.parametrize(("apart", "seed"), [(("r1",), 2), (("r1", "r2"), 1)])
def test_what_robots_do_out_of_reach_of_the_coordinator_is_not_done_by_those_in_its_reach(seed, apart):
    """Both sides have queued tasks that they could begin."""
    script = orphaned(seed)
    others = [robot.name for robot in script.robots if robot.name not in apart]
    cut = FaultSpec(
        robot=others[0], side=tuple(others[1:]), kind=FaultKind.PARTITION, at_s=KILLED_S, until_s=KILLED_S + 60.0
    )
    done = Done(msgspec.structs.replace(script, faults=(cut,)))
    assert done.begun == dict.fromkeys((order.task.id for order in script.tasks), 1)
    assert done.took_s < 120.0


FOUND = (1724, 208486, 209548, 709417)
"""In the first a coordinator and most of its robots are apart."""


@pytest.mark.parametrize("seed", FOUND)
def test_what_soaks_have_found_in_teams_without_a_coordinator_stays_mended(seed):
    verdict = run_trial(draw_script(seed))
    assert verdict.broken == ()
