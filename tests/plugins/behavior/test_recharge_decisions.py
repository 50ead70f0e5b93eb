"""When a robot decides to charge, and when it yields its charger; the behavior on fakes."""

from types import SimpleNamespace

import pytest

from robrain.plugins.behavior.errand import STEP_S, Failed, Run
from robrain.plugins.behavior.recharge import (
    AT_HOME_M,
    FULL_ERROR,
    GUARD_S,
    HOMEWARD,
    QUEUE_S,
    RETRY_NS,
    RechargeBehavior,
)
from robrain.plugins.skill.home import ChargerPlace
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer, TaskOffer
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.stock_kinds import Recharge
from robrain.protocol.model.tasks.task import Task, TaskState
from tests.plugins.behavior.bare_errand import other, run
from tests.plugins.behavior.bare_recharge import CHARGER, RESERVE_S, BareRecharge


def test_robot_with_just_enough_for_the_way_and_the_reserve_stays_and_with_less_goes_to_charge():
    robot = BareRecharge(CHARGER)
    robot.has(RESERVE_S, 4.0)
    robot.guard()
    assert robot.it.run is None
    robot.has(RESERVE_S, 4.0, -0.1)
    robot.guard()
    made = robot.it.run
    assert made.own == "recharge"
    assert made.task == Task(
        id="home-r5-1",
        kind="recharge",
        place=CHARGER.place,
        priority=HOMEWARD,
        parameters=Recharge(yaw_rad=1.0, until_soc=0.95).json,
    )
    assert (made.goal, made.path_m) == (CHARGER.place, 4.0)
    assert robot.tasks.occupies("recharge")
    refused = robot.tasks.offer(
        TaskOffer(task=Task(id="e", kind="explore", place=Point2D(0.0, 0.0)), epoch=1, lease_s=60.0), 0
    )
    assert refused.why == "r5 goes home: the way home needs 680 J of 680 J usable"


def test_while_others_have_all_chargers_it_keeps_what_the_queue_takes_as_well():
    robot = BareRecharge(CHARGER)
    robot.errand.others = [other("r1", 4.0, 0.0)]
    robot.has(RESERVE_S + QUEUE_S, 4.0)
    robot.guard()
    assert robot.it.run is None
    robot.has(RESERVE_S + QUEUE_S, 4.0, -0.1)
    robot.guard()
    assert robot.it.run.own == "recharge"


def test_robot_at_a_task_keeps_no_reserve_and_gives_the_task_back_before_it_goes():
    robot = BareRecharge(CHARGER)
    robot.work_at_a_task()
    robot.has(0.0, 4.0)
    robot.guard()
    robot.tasks.check_lease(0)
    assert robot.tasks.is_busy
    robot.has(0.0, 4.0, -0.1)
    robot.guard()
    assert robot.it.run is None
    assert robot.it.period_s == STEP_S
    robot.tasks.check_lease(0)
    status = robot.tasks.status
    assert (status.state, status.why) == (TaskState.CANCELLED, "needs 80 J of 80 J usable")
    robot.it.step()
    assert robot.it.run.own == "recharge"


@pytest.mark.parametrize("what", ["battery", "pose", "charging"])
def test_robot_that_cannot_judge_or_is_being_charged_stays(what):
    robot = BareRecharge(CHARGER)
    robot.usable_j = 0.0
    if what == "charging":
        robot.battery.charging = True
    else:
        setattr(robot.board, what, None)
    robot.guard()
    assert robot.it.run is None
    assert robot.it._wanted == ""


def test_energy_is_checked_every_two_seconds():
    robot = BareRecharge(CHARGER)
    robot.it.step()
    robot.usable_j = 0.0
    robot.errand.wait(GUARD_S - 0.001)
    robot.it.step()
    assert robot.it.run is None
    robot.errand.wait(0.001)
    robot.it.step()
    assert robot.it.run is not None


def test_way_home_is_planned_again_only_when_its_bound_is_not_enough_or_other_chargers_are_free():
    robot = BareRecharge(CHARGER)
    robot.has(RESERVE_S, 6.0)
    robot.guard()
    assert robot.ways_home == 1
    robot.errand.at = Pose2D(2.0, 0.0, 0.0)  # at most 6 m now
    robot.guard()
    assert robot.ways_home == 1
    robot.errand.at = Pose2D(0.0, 2.01, 0.0)
    robot.guard()
    assert robot.ways_home == 2
    robot.has(RESERVE_S + QUEUE_S, 6.0)
    robot.errand.others = [other("r1", 4.0, 0.0)]
    robot.guard()
    assert robot.ways_home == 3
    robot.guard()
    assert robot.ways_home == 3


@pytest.mark.parametrize(("away_m", "goes"), [(AT_HOME_M - 0.01, False), (AT_HOME_M, True)])
def test_without_a_charger_the_robot_goes_back_to_its_start_if_it_is_not_there(away_m, goes):
    robot = BareRecharge(start=Point2D(away_m, 0.0))
    robot.start_m = away_m
    robot.usable_j = 0.0
    robot.guard()
    assert (robot.it.run is not None) is goes
    if goes:
        made = robot.it.run
        assert (made.own, made.goal, made.task.priority) == ("go home", Point2D(away_m, 0.0), HOMEWARD)
        assert made.task.id == "home-r5-1"
        assert robot.errand.set_out == [(made.goal, round(HOMEWARD))]
        assert run(made.script) == {}


def test_robot_without_a_way_home_tries_again_after_its_time():
    robot = BareRecharge(CHARGER)
    robot.errand.no_way_to = [CHARGER.place]
    robot.usable_j = 0.0
    robot.guard()
    assert robot.it.run is None
    planned = len(robot.errand.planned)
    robot.errand.wait((RETRY_NS - 1) / 1e9)
    robot.it.step()
    assert len(robot.errand.planned) == planned
    robot.errand.wait(1e-9)
    robot.errand.no_way_to = []
    robot.it.step()
    assert robot.it.run.own == "recharge"


# -- when it is asked -------------------------------------------------------------------------------------------


def test_robot_that_is_asked_to_go_home_goes_at_once_unless_it_charges_already():
    robot = BareRecharge(CHARGER)
    robot.it._ask("the task cannot be paid")
    first = robot.it.run
    assert first.own == "recharge"
    assert robot.it._wanted == ""
    robot.it._ask("again")
    assert robot.it.run is first
    assert robot.it._wanted == ""


def test_robot_that_is_asked_while_it_is_at_a_task_goes_when_that_has_been_given_back():
    robot = BareRecharge(CHARGER)
    robot.work_at_a_task()
    robot.it._ask("the task cannot be paid")
    assert robot.it.run is None
    robot.it.step()
    assert robot.it.run is None
    robot.tasks.end("e", TaskState.FAILED)
    assert robot.tasks.status.state is TaskState.FAILED
    robot.it.step()
    assert robot.it.run.own == "recharge"


def test_halted_robot_does_not_want_home_any_more():
    robot = BareRecharge(CHARGER)
    robot.work_at_a_task()
    robot.it._ask("home")
    robot.it.emergency_halt()
    assert (robot.it._wanted, robot.it.run) == ("", None)


# -- making way -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "leaves"),
    [
        (lambda robot: None, True),
        (lambda robot: robot.errand.others.clear(), False),
        (lambda robot: setattr(robot.errand, "at", Pose2D(3.49, 0.0, 0.0)), False),
        (lambda robot: setattr(robot.errand, "at", Pose2D(3.5, 0.0, 0.0)), True),
        (lambda robot: setattr(robot.board, "pose", None), False),
        (lambda robot: setattr(robot.errand.travel, "lost", "it is lost"), False),
        (lambda robot: robot.work_at_a_task(), False),
        (lambda robot: robot.tasks.occupy("search", firm="looks for itself"), False),
        (lambda robot: robot.errand.chargers.clear(), False),
    ],
)
def test_robot_that_needs_its_charger_no_more_leaves_it_to_a_mate_that_waits(change, leaves):
    robot = BareRecharge(CHARGER)
    robot.errand.at = Pose2D(4.0, 0.0, 0.0)
    robot.errand.others = [other("r1", 2.0, 3.0, Point2D(9.0, 9.0), behavior="recharge")]
    change(robot)
    robot.it.step()
    assert (robot.it.run is not None) is leaves
    if leaves:
        assert robot.it.run.own == "make room"
        assert robot.tasks.occupies("recharge")
        assert robot.it.run.task.id == "aside-r5"


WANTED = Recharge(yaw_rad=1.0, until_soc=0.9)
TASK = Task(id="c", kind="recharge", place=CHARGER.place, parameters=WANTED.json)


def charged(robot, soc, *, comes=True, begun_soc=0.5, at=4.0):
    """Result of charging if the battery has this charge when the current ends; `comes`: whether there was a current."""
    robot.errand.at = Pose2D(at, 0.0, 0.0)
    robot.battery.soc, robot.battery.charging = begun_soc, comes
    robot.it._queue = SimpleNamespace(must_give=lambda _charger: False)
    script = robot.it.charge_at(CHARGER, WANTED.until_soc)
    for number in range(3000):
        try:
            next(script)
        except StopIteration as end:
            return end.value
        robot.errand.wait(0.25)
        if number == 20:
            robot.battery.soc, robot.battery.charging = soc, False
    raise AssertionError("it does not end")


@pytest.mark.parametrize(("soc", "is_full"), [(0.9 - FULL_ERROR + 0.001, True), (0.9 - FULL_ERROR - 0.001, False)])
def test_battery_may_be_full_before_the_estimate_says_so_but_not_long_before(soc, is_full):
    robot = BareRecharge(CHARGER)
    if is_full:
        assert charged(robot, soc)["soc"] == round(soc, 3)
    else:
        with pytest.raises(Failed, match="the charger has stopped at 84%"):
            charged(robot, soc)


def test_charger_that_never_gives_is_named_and_so_is_where_the_robot_stood():
    robot = BareRecharge(CHARGER)
    with pytest.raises(Failed, match=r"the charger gives nothing, 0\.02 m from its place"):
        charged(robot, 0.5, comes=False, at=4.02)
    with pytest.raises(Failed, match="the charger gives nothing"):
        charged(robot, 0.85, comes=False, begun_soc=0.85)


def test_robot_that_must_give_its_place_has_no_result():
    robot = BareRecharge(CHARGER)
    robot.errand.at = Pose2D(4.0, 0.0, 0.0)
    robot.battery.charging = True
    robot.it._queue = SimpleNamespace(must_give=lambda _charger: True)
    assert run(robot.it.charge_at(CHARGER, WANTED.until_soc)) == {}


def test_battery_that_says_nothing_fails_the_task():
    robot = BareRecharge(CHARGER)
    robot.board.battery = None
    with pytest.raises(Failed, match="the battery says nothing"):
        robot.it.battery()


@pytest.mark.parametrize(("charging", "energy_j", "charged_j"), [(False, 30.0, 0.0), (True, 0.0, 60.0)])
def test_what_comes_from_the_charger_is_no_cost_of_the_way(charging, energy_j, charged_j):
    robot = BareRecharge(CHARGER)
    made = Run(TASK, WANTED, lambda: iter(()), CHARGER.place, 4.0, 0.0)
    made.measured_ns = robot.errand.clock.now_ns()
    robot.errand.wait(2.0)
    robot.battery.charging = charging
    robot.battery.current_a = -2.0 if charging else 1.0
    robot.it._measure(made)
    assert (made.energy_j, robot.it._charged_j) == pytest.approx((energy_j, charged_j))


def test_task_that_is_taken_on_is_the_answer_to_what_was_wanted_and_its_charger_is_known(monkeypatch):
    robot = BareRecharge(CHARGER)
    robot.it._wanted = "home"
    for accepted in (False, True):
        answer = TaskAnswer(accepted=accepted)
        monkeypatch.setattr(RechargeBehavior.__mro__[1], "accept", lambda _self, _task, answer=answer: answer)
        assert robot.it.accept(TASK) is answer
        assert robot.it._wanted == ("" if accepted else "home")
    assert robot.learned == [CHARGER]


# -- the whole --------------------------------------------------------------------------------------------------

OTHER = ChargerPlace(8.0, 0.0)


def test_charger_of_no_use_is_left_for_the_next_and_the_last_trouble_is_told():
    robot = BareRecharge(CHARGER, OTHER)
    tried = []

    def gives_nothing(charger, _task):
        tried.append(charger)
        raise Failed(f"{charger.x_m:g} gives nothing")
        yield

    robot.it.charge_at = gives_nothing
    robot.errand.progress = []
    with pytest.raises(Failed, match="8 gives nothing"):
        run(robot.it.play(TASK, WANTED))
    assert tried == [CHARGER, OTHER]


def test_robot_that_made_room_comes_back_and_ends_with_what_came_of_it_then():
    robot = BareRecharge(CHARGER, OTHER)
    results = [{}, {"soc": 0.9}]

    def charges(_charger, _task):
        return results.pop(0)
        yield

    robot.it.charge_at = charges
    robot.errand.progress = []
    robot.it._charged_j = 99.0
    assert run(robot.it.play(TASK, WANTED)) == {"soc": 0.9}
    # The one that it gave up is the other's for now: it went to the other one, aside of the first in between.
    goals = [goal for goal, _ in robot.errand.set_out]
    assert (goals[0], goals[-1]) == (CHARGER.place, OTHER.place)
    assert robot.it._charged_j == 0.0


def test_robot_that_is_there_too_early_waits_and_counts_as_there_from_then_on():
    robot = BareRecharge(CHARGER)
    robot.errand.progress = []
    robot.errand.at = Pose2D(4.0, 0.0, 0.0)
    robot.battery.soc, robot.battery.charging = 0.95, True
    begins_ns = robot.errand.clock.now_ns() + 10**9
    later = Task(id="c", kind="recharge", place=CHARGER.place, earliest_ns=begins_ns)
    robot.it.run = made = Run(later, WANTED, lambda: iter(()), CHARGER.place, 4.0, 0.0)
    script = robot.it.play(later, WANTED)
    robot.errand.wait(0.999)
    assert run(script, 5) is ...
    assert made.there_ns is None
    robot.errand.wait(0.001)
    assert run(script)["soc"] == 0.95
    assert made.there_ns == begins_ns
