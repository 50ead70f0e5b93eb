import msgspec
import pytest

from robrain.algorithms.allocation.allocator import AUCTION
from robrain.lab.soak.fault_script import (
    CancelOrder,
    FaultScript,
    HaltOrder,
    ScriptError,
    ScriptRobot,
    TaskInput,
    read_script,
    script_json,
)
from robrain.lab.soak.judge import Judge, TeamRule
from robrain.lab.soak.script_drawing import draw_script
from robrain.lab.soak.soak_run import SoakRun
from robrain.lab.soak.trial import run_trial
from robrain.protocol.border.border import Border
from robrain.protocol.clock import to_seconds
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from robrain.sim.faults.fault_spec import COORDINATOR, FaultKind, FaultSpec
from robrain.sim.points.point_team import POINT_TICK_S


def visit(name, x_m, y_m, at_s=0.0, **fields):
    return TaskInput(at_s=at_s, task=Task(id=name, kind="visit", place=Point2D(x_m, y_m), service_s=2.0, **fields))


TEAM = FaultScript(
    seed=1,
    robots=(ScriptRobot(name="r1", place=Point2D(0.0, 0.0)), ScriptRobot(name="r2", place=Point2D(10.0, 0.0))),
    chargers=(Point2D(0.0, 0.0),),
    tasks=(visit("t1", 5.0, 5.0), visit("t2", 9.0, 9.0), visit("t3", 1.0, 8.0), visit("t4", 3.0, 3.0, after=("t1",))),
)


def with_faults(*faults, **changes):
    return msgspec.structs.replace(TEAM, faults=faults, **changes)


def said(script, *topics):
    """Times, s, and messages of a run, to its end."""
    run = SoakRun(script)
    judge, inbox, found = Judge(run), Inbox(every=True, border=Border()), []
    for topic in topics:
        run.wire.subscribe(inbox, topic)
    while not judge.is_over:
        run.tick()
        judge.step()
        found += [(to_seconds(run.now_ns), received.message) for received in inbox.drain()]
    run.close()
    return found


@pytest.mark.parametrize("method", ["nearest", AUCTION])
def test_a_team_without_faults_does_all_its_tasks(method):
    verdict = run_trial(msgspec.structs.replace(TEAM, method=method))
    assert verdict.broken == ()
    assert verdict.done == 4


def test_the_operator_gives_up_what_waits_for_a_task_that_waits_for_a_cancelled_one():
    tasks = (visit("t1", 9.0, 9.0), visit("t2", 1.0, 1.0, after=("t1",)), visit("t3", 2.0, 1.0, 5.0, after=("t2",)))
    script = msgspec.structs.replace(TEAM, tasks=tasks, cancels=(CancelOrder(at_s=1.0, task="t1"),))
    verdict = run_trial(script)
    assert (verdict.broken, verdict.done) == ((), 0)


def test_a_robot_that_was_halted_while_it_charged_is_given_tasks_afterwards():
    robots = (ScriptRobot(name="r1", place=Point2D(7.0, 4.0), soc=0.33),)
    tasks = (visit("t1", 12.0, 9.0, 0.5), visit("t2", 15.0, 9.0, 0.5))
    halts = (HaltOrder(at_s=24.0, until_s=48.0),)
    verdict = run_trial(msgspec.structs.replace(TEAM, robots=robots, tasks=tasks, halts=halts, method=AUCTION))
    assert (verdict.broken, verdict.done) == ((), 2)


FAULTS = {
    "coordinator killed": FaultSpec(robot=COORDINATOR, kind=FaultKind.KILL, at_s=3.0, until_s=4.0),
    "coordinator hangs": FaultSpec(robot=COORDINATOR, kind=FaultKind.HANG, at_s=3.0, until_s=9.0),
    "robot killed for good": FaultSpec(robot="r1", kind=FaultKind.KILL, at_s=3.0),
    "robot restarted": FaultSpec(robot="r1", kind=FaultKind.KILL, at_s=3.0, until_s=3.1),
    "robot cut off": FaultSpec(robot="r1", kind=FaultKind.PARTITION, at_s=3.0, until_s=12.0),
    "robot slow": FaultSpec(robot="r1", kind=FaultKind.SLOW, at_s=1.0, until_s=20.0, period_s=0.5),
    "half is lost": FaultSpec(robot="r1", kind=FaultKind.LOSE, at_s=1.0, until_s=20.0, share=0.5),
    "disk full": FaultSpec(robot=COORDINATOR, kind=FaultKind.DISK_FULL, at_s=1.0, until_s=12.0),
    "battery drained": FaultSpec(robot="r1", kind=FaultKind.DRAIN, at_s=2.0, soc=0.03),
}


@pytest.fixture(scope="module")
def undisturbed():
    return said(TEAM, COORDINATOR_STATE, ROBOT_STATE)


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS)
def test_the_team_does_its_tasks_in_spite_of_a_fault_that_changes_the_run(fault, undisturbed):
    verdict = run_trial(with_faults(fault))
    assert verdict.broken == ()
    assert verdict.done == 4
    assert said(with_faults(fault), COORDINATOR_STATE, ROBOT_STATE) != undisturbed


def test_a_robot_that_could_not_know_of_a_halt_is_told_by_the_coordinator():
    halt = HaltOrder(at_s=5.0, until_s=15.0)
    cut = FaultSpec(robot="r1", kind=FaultKind.PARTITION, at_s=4.0, until_s=6.0)
    states = said(with_faults(cut, halts=(halt,)), ROBOT_STATE)
    halted_s = {name: [at_s for at_s, state in states if state.robot == name and state.halted] for name in ("r1", "r2")}
    assert halted_s["r2"][0] == pytest.approx(5.1, abs=0.15)
    assert 6.0 <= halted_s["r1"][0] <= 7.0


def ticks_at_two_robots(script):
    """In how many ticks two robots are at work, the robots that ever were, and what the judge found."""
    run = SoakRun(script)
    judge, both, begun = Judge(run), 0, set()
    while not judge.is_over:
        run.tick()
        judge.step()
        at = [name for name in run.robots if run.work(name)]
        both += len(at) > 1
        begun |= set(at)
    broken = judge.finish()
    run.close()
    return both, begun, broken


@pytest.mark.slow
@pytest.mark.parametrize(("component", "skew_s"), [(COORDINATOR, 6 * 86_400.0), ("r1", -4.0)])
def test_a_wall_clock_that_is_set_changes_nothing_in_processes_that_run(component, skew_s):
    fault = FaultSpec(robot=component, kind=FaultKind.CLOCK_SKEW, at_s=1.0, until_s=8.0, skew_s=skew_s)
    assert said(with_faults(fault), TASK_EVENT) == said(with_faults(), TASK_EVENT)


@pytest.mark.slow
@pytest.mark.parametrize(("component", "skew_s"), [(COORDINATOR, 18.0), ("r2", 6 * 86_400.0)])
def test_a_process_that_starts_again_with_another_clock_works_as_before(component, skew_s):
    skew = FaultSpec(robot=component, kind=FaultKind.CLOCK_SKEW, at_s=0.5, until_s=30.0, skew_s=skew_s)
    kill = FaultSpec(robot=component, kind=FaultKind.KILL, at_s=0.6, until_s=1.2)
    script = with_faults(skew, kill, tasks=(visit("t1", 10.0, 19.0, at_s=3.0),))
    assert ticks_at_two_robots(script) == (0, {"r2"}, [])


def test_a_robot_that_stood_still_does_not_take_old_summaries_for_new_ones():
    # Summaries of the first moments of its hang are in its inbox; later ones are lost, and another has its task.
    hang = FaultSpec(robot="r2", kind=FaultKind.HANG, at_s=3.0, until_s=6.0)
    cut = FaultSpec(robot="r2", kind=FaultKind.PARTITION, at_s=3.6, until_s=30.0)
    both, begun, broken = ticks_at_two_robots(with_faults(hang, cut, tasks=(visit("t1", 10.0, 19.0, at_s=1.0),)))
    assert begun == {"r1", "r2"}
    assert broken == []
    assert both <= (6.0 - 5.0) / POINT_TICK_S + 2  # while it hangs, and the step in which it wakes


def test_a_script_is_the_same_after_its_file(tmp_path):
    script = draw_script(5)
    (tmp_path / "s.json").write_bytes(script_json(script))
    assert read_script(tmp_path / "s.json") == script


BAD = {
    "no file": (None, "cannot be read"),
    "an unknown key": (b'{"seed": 1, "wind": 3}', "unknown field `wind`"),
    "a fault of nobody": (
        script_json(TEAM).replace(b'"faults": []', b'"faults": [{"robot": "r7", "kind": "hang", "at_s": 1}]'),
        "expected one of r1, r2 or coordinator, got robot = 'r7'",
    ),
}


@pytest.mark.parametrize(("text", "told"), BAD.values(), ids=BAD)
def test_a_file_that_is_no_script_is_refused_in_one_sentence(tmp_path, text, told):
    path = tmp_path / "s.json"
    if text is not None:
        path.write_bytes(text)
    with pytest.raises(ScriptError, match=told) as caught:
        read_script(path)
    assert str(caught.value).startswith(f"{path}: ")


def test_drawn_scripts_differ_by_seed_and_are_equal_for_equal_seeds():
    scripts = [draw_script(seed) for seed in (*range(40), 40621)]
    assert scripts == [draw_script(script.seed) for script in scripts]
    for one in (script for script in scripts if script.consensus):
        assert 2 * sum(each.kind is FaultKind.KILL and each.until_s is None for each in one.faults) < len(one.robots)
    assert {fault.kind for script in scripts for fault in script.faults} == {
        kind for kind in FaultKind if kind in {fault.kind for fault in FAULTS.values()}
    } | {FaultKind.CLOCK_SKEW, FaultKind.DELAY, FaultKind.REORDER}


def test_the_judge_sees_a_task_that_is_at_two_robots():
    run = SoakRun(TEAM)
    run.work = lambda robot: "t1"
    judge = Judge(run)
    for _ in range(15):
        run.tick()
        judge.step()
    run.close()
    assert [broken.invariant for broken in judge.broken] == [TeamRule.TWO_AT_ONCE]


def test_the_judge_sees_a_task_that_the_book_has_lost():
    run = SoakRun(TEAM)
    judge = Judge(run)
    for _ in range(10):
        run.tick()
        judge.step()
    del run.leader.tasks._open["t2"]
    run.leader.tasks.journal._db.execute("DELETE FROM task WHERE id = 't2'")
    broken = judge.finish()
    run.close()
    assert (TeamRule.LOST, "t2 was acknowledged, and the coordinator does not know it") in [
        (one.invariant, one.what) for one in broken
    ]


@pytest.mark.parametrize("until_s", [None, 30.0])
def test_the_operator_resumes_those_who_are_there_and_waits_for_nobody_who_has_died(until_s):
    killed = FaultSpec(robot="r1", kind=FaultKind.KILL, at_s=6.0, until_s=until_s)
    verdict = run_trial(with_faults(killed, halts=(HaltOrder(at_s=5.0, until_s=8.0),)))
    assert verdict.broken == ()
    assert verdict.done == 4


def test_the_operator_resumes_a_robot_that_was_cut_off_when_the_halt_ended():
    cut = FaultSpec(robot="r1", kind=FaultKind.PARTITION, at_s=6.0, until_s=30.0)
    states = said(with_faults(cut, halts=(HaltOrder(at_s=5.0, until_s=8.0),)), ROBOT_STATE)
    halted_s = [at_s for at_s, state in states if state.robot == "r1" and state.halted]
    assert 29.9 < halted_s[-1] < 33.0


@pytest.mark.slow
def test_a_robot_that_missed_a_halt_as_the_coordinator_did_hears_of_it_by_another_robot():
    cut = FaultSpec(robot=COORDINATOR, kind=FaultKind.PARTITION, at_s=9.0, until_s=10.5)
    killed = FaultSpec(robot="r1", kind=FaultKind.KILL, at_s=9.5, until_s=11.0)
    obeying = with_faults(cut, killed, halts=(HaltOrder(at_s=10.0, until_s=24.0),))
    halted = {state.robot for at_s, state in said(obeying, ROBOT_STATE) if 13.0 < at_s < 24.0 and state.halted}
    assert halted == {"r1", "r2"}
    assert run_trial(obeying).broken == ()


@pytest.mark.slow
def test_a_robot_that_charges_later_gets_the_task_for_which_it_has_too_little_now():
    # Alone and at a tenth of its charge, it refuses six times before its own guard sends it to the charger.
    robot = ScriptRobot(name="r1", place=Point2D(9.0, 9.0), soc=0.11)
    script = msgspec.structs.replace(TEAM, robots=(robot,), tasks=(visit("t1", 20.0, 20.0),))
    verdict = run_trial(script)
    assert (verdict.broken, verdict.done) == ((), 1)
