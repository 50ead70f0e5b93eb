import msgspec

from robrain.lab.soak.script_drawing import draw_script
from robrain.lab.soak.shrink import Shrinker
from robrain.sim.faults.fault_spec import FaultKind, FaultSpec

SCRIPT = next(script for script in map(draw_script, range(100)) if len(script.faults) >= 6 and script.halts)


def needs(*faults, tasks=()):
    """Whether a script fails: if it has all of these, the faults by robot, kind and beginning."""
    wanted = {(fault.robot, fault.kind, fault.at_s) for fault in faults}

    def fails(script):
        there = {(fault.robot, fault.kind, fault.at_s) for fault in script.faults}
        return wanted <= there and set(tasks) <= {order.task.id for order in script.tasks}

    return fails


def test_a_script_is_shrunk_to_the_faults_and_tasks_that_it_needs():
    pair = (SCRIPT.faults[1], SCRIPT.faults[4])
    shrunk = Shrinker(needs(*pair, tasks=("t3",))).shrink(SCRIPT)
    assert [(fault.kind, fault.at_s) for fault in shrunk.faults] == [(fault.kind, fault.at_s) for fault in pair]
    assert [order.task.id for order in shrunk.tasks] == ["t3"]
    assert (shrunk.halts, shrunk.cancels) == ((), ())


def test_a_robot_that_stays_alive_is_left_in():
    first, *others = SCRIPT.robots
    dead = FaultSpec(robot=first.name, kind=FaultKind.KILL, at_s=1.0)
    script = msgspec.structs.replace(SCRIPT, faults=(dead,), robots=(first, others[0]))
    shrunk = Shrinker(lambda script: dead in script.faults).shrink(script)
    assert [robot.name for robot in shrunk.robots] == [first.name, others[0].name]


def test_faults_are_made_as_short_as_they_can_be():
    long = next(fault for fault in SCRIPT.faults if fault.until_s is not None and fault.until_s - fault.at_s > 2.0)

    def fails(script):
        return any(one.at_s == long.at_s and one.until_s - one.at_s >= 1.0 for one in script.faults if one.until_s)

    (shrunk,) = Shrinker(fails).shrink(SCRIPT).faults
    assert 1.0 <= shrunk.until_s - shrunk.at_s < 2.1


def test_tasks_do_not_wait_for_those_that_were_left_out():
    script = next(one for one in map(draw_script, range(100)) if any(order.task.after for order in one.tasks))
    child = next(order.task.id for order in script.tasks if order.task.after)
    (order,) = Shrinker(needs(tasks=(child,))).shrink(script).tasks
    assert order.task.after == ()


def test_robots_that_are_left_out_are_on_no_side_of_a_cut():
    first, *others = SCRIPT.robots
    cut = FaultSpec(
        robot=first.name, kind=FaultKind.PARTITION, at_s=1.0, until_s=9.0, side=tuple(one.name for one in others)
    )
    script = msgspec.structs.replace(SCRIPT, faults=(cut,))
    shrunk = Shrinker(lambda script: bool(script.faults) and len(script.robots) >= 2).shrink(script)
    assert len(shrunk.robots) == 2
    assert set(shrunk.faults[0].side) <= {robot.name for robot in shrunk.robots}
