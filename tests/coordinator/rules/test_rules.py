"""Rules: what is sensed makes tasks, once, whatever order readings come in and whoever restarts."""

import pytest

from robrain.coordinator.rules.task_rules import TaskRules
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.tasks.task_messages import TASK_CANCEL, TaskRequest
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import TaskState
from tests.coordinator.rules.sensed_team import PLACE, SensedTeam, rule

HELD = {"above": 26.0, "for_s": 8.0, "clear_at": 24.0}


@pytest.fixture
def begin(team):
    return lambda *rules: SensedTeam(team, *rules)


def test_one_reading_above_the_threshold_makes_a_task_at_its_place(begin):
    sensed = begin(rule(task={"priority": 3.0, "deadline_s": 90.0}))
    sensed.senses(25.9)
    assert sensed.made() == []
    at_s = sensed.now_s
    sensed.senses(26.1)
    (record,) = sensed.made()
    assert (record.by, record.task.kind, record.task.place, record.task.priority) == ("rule:heat", "visit", PLACE, 3.0)
    assert record.task.deadline_ns == pytest.approx(to_ns(at_s + 90.0), abs=to_ns(0.1))
    assert record.task.id.startswith("heat-")
    assert record.state is TaskState.RUNNING  # it is planned and offered like any other


MANY = {"cooldown_s": 0.0, "max_open": 10}
CLEAR_AT = {"above": 26.0, "clear_at": 24.0}
BELOW = {"below": 5.0, "clear_at": 7.0}


@pytest.mark.parametrize(
    ("fields", "steps"),
    [
        # Held long enough, a threshold makes one task and no other: from the first to the fourth there are 6 s.
        ({"reading": HELD, **MANY}, [([27.0] * 4, 0), ([27.0], 1), ([28.0] * 30, 1)]),
        # A reading below the threshold restarts the time.
        ({"reading": HELD}, [([27.0] * 3 + [25.0] + [27.0] * 4, 0), ([27.0], 1)]),
        # The rule is armed again at the clear level: 25 is below the threshold and above that level.
        ({"reading": CLEAR_AT, **MANY}, [([27.0, 25.0, 27.0], 1), ([24.0, 27.0], 2)]),
        ({"reading": BELOW, **MANY}, [([5.0], 0), ([4.0, 6.0, 4.0], 1), ([7.0, 4.0], 2)]),
    ],
)
def test_tasks_follow_from_readings(begin, fields, steps):
    sensed = begin(rule(**fields))
    for values, count in steps:
        sensed.senses(*values)
        assert len(sensed.made()) == count


def test_cooldown_keeps_a_plume_from_making_a_task_at_each_mote(begin):
    sensed = begin(rule(cooldown_s=60.0, max_open=100))
    for number in range(1, 21):
        sensed.senses(27.0, mote=f"m{number}", every_s=0.5)
    assert len(sensed.made()) == 1
    sensed.team.run(60.0)
    sensed.senses(27.0, 27.0, mote="m7", every_s=0.5)  # still so, and not told yet
    assert len(sensed.made()) == 2


def test_one_rule_for_the_team_waits_until_all_motes_are_clear(begin):
    sensed = begin(rule(per="team", cooldown_s=0.0, max_open=10))
    sensed.senses(27.0, mote="m1")
    sensed.senses(27.0, mote="m2")
    sensed.senses(20.0, mote="m1")
    sensed.senses(27.0, mote="m1")
    assert len(sensed.made()) == 1
    sensed.senses(20.0, mote="m1")
    sensed.senses(20.0, mote="m2")
    sensed.senses(27.0, mote="m2")
    assert len(sensed.made()) == 2


def test_a_mote_that_died_in_alarm_does_not_keep_the_team_in_alarm(begin):
    sensed = begin(rule(per="team", cooldown_s=0.0, max_open=10))
    sensed.senses(27.0, mote="m1")
    sensed.senses(27.0, mote="m2")
    sensed.senses(20.0, mote="m1")
    sensed.team.run(65.0)  # m2 is silent
    sensed.senses(20.0, 27.0, mote="m1")
    assert len(sensed.made()) == 2


def test_rate_of_rise_makes_a_task_and_slow_warming_does_not(begin):
    sensed = begin(rule(reading={"rising_per_min": 6.0, "over_s": 20.0}))
    sensed.senses(*[20.0 + 0.1 * step for step in range(30)])  # 3 K a minute
    assert sensed.made() == []
    sensed.senses(*[23.0 + 0.4 * step for step in range(10)])  # 12 K a minute
    (record,) = sensed.made()
    reason = first_reason(sensed, record)
    assert 6.0 < reason.values["rate_per_min"] < 12.5
    assert reason.values["comparison"] == "rising_per_min"


@pytest.mark.parametrize("restarts", [False, True])
@pytest.mark.parametrize("number", [{}, {"sequence": None}], ids=["numbered", "without a number"])
def test_repeated_readings_count_once_also_after_a_restart(begin, number, restarts):
    one = rule(cooldown_s=0.0, max_open=10)
    sensed = begin(one)
    reading = sensed.sense(27.0, **number)
    sensed.again(reading, via="r2")
    sensed.team.run(1.0)
    sensed.senses(20.0, **number)  # armed again
    if restarts:
        sensed.restart(one)
    sensed.again(reading)  # the robot has fetched it from the log once more
    sensed.team.run(1.0)
    assert len(sensed.made()) == 1


def test_stored_readings_of_long_ago_make_no_task(begin):
    sensed = begin(rule(reading={"above": 26.0, "max_age_s": 30.0}))
    sensed.team.run(100.0)
    for age_s in (90.0, 80.0, 70.0, 31.0):
        sensed.senses(30.0, age_s=age_s, every_s=0.1)
    assert sensed.made() == []
    sensed.senses(30.0, age_s=29.0)
    assert len(sensed.made()) == 1


def test_only_the_named_motes_robots_and_area_count(begin):
    area = {"x_min_m": 6.0, "y_min_m": 3.0, "x_max_m": 7.0, "y_max_m": 5.0}
    sensed = begin(rule(reading={"above": 26.0, "motes": ["m1"], "robots": ["r1"], "area": area}, cooldown_s=0.0))
    sensed.senses(27.0, mote="m2")
    sensed.senses(27.0, via="r2")
    sensed.senses(27.0, place=Point2D(5.0, 4.0))
    sensed.senses(27.0, place=None)
    sensed.senses(27.0, quantity="humidity_pct")
    assert sensed.made() == []
    sensed.senses(27.0)
    assert len(sensed.made()) == 1


def test_parameters_are_filled_from_the_reading(begin):
    parameters = {"quantity": "{quantity}", "duration_s": 30.0}
    sensed = begin(rule(task={"kind": "monitor", "parameters": parameters, "place_m": [5.0, 3.0]}))
    sensed.robot.plugins.append("monitor")
    sensed.restart(rule(task={"kind": "monitor", "parameters": parameters, "place_m": [5.0, 3.0]}))
    sensed.team.run(1.0)
    sensed.senses(27.0)
    (record,) = sensed.made()
    assert record.task.parameters == {"quantity": "temperature_c", "duration_s": 30.0}
    assert record.task.place == Point2D(5.0, 3.0)


def test_an_event_of_a_plugin_makes_a_task_where_its_robot_is(begin):
    event = {"plugin": "monitor", "event": "changed", "field": "share", "above": 0.1}
    sensed = begin(rule(event=event, cooldown_s=0.0, max_open=10))
    sensed.notify({"share": 0.05})
    sensed.notify({"share": "much"})
    sensed.notify({})
    sensed.notify({"share": 0.5}, event="other", run_s=1.0)
    assert sensed.made() == []
    sensed.notify({"share": 0.5}, run_s=1.0)
    (record,) = sensed.made()
    assert record.task.place == Point2D(4.5, 3.0)
    sensed.notify({"share": 0.5}, run_s=1.0)
    assert len(sensed.made()) == 2  # each notification counts by itself


def test_a_task_that_cannot_be_is_refused_in_words_and_not_tried_at_each_reading(begin):
    sensed = begin(rule(task={"place_m": [0.1, 70.0]}, cooldown_s=0.0))
    sensed.senses(27.0, 27.0, 27.0)
    assert sensed.made() == []
    status = sensed.status()
    assert status.refused == 1
    assert "outside of the map" in status.why
    assert [(one.topic, one.key) for one in sensed.team.coordinator._wire.refusals.counts()] == [("rule", "heat")]


def test_a_reading_without_a_place_makes_no_task_that_needs_one(begin):
    sensed = begin(rule(), rule("fixed", task={"place_m": [5.0, 3.0]}))
    sensed.senses(27.0, place=None)
    assert sensed.made() == []
    assert "does not know where it is" in sensed.status().why
    assert len(sensed.made("fixed")) == 1


@pytest.mark.parametrize("per", ["mote", "team"])
def test_after_a_restart_no_task_is_made_twice(begin, per):
    one = rule(cooldown_s=0.0, max_open=10, per=per)
    sensed = begin(one)
    sensed.senses(27.0, 27.0)
    sensed.restart(one)
    sensed.senses(27.0, 27.0)
    assert len(sensed.made()) == 1
    sensed.team.ask(TASK_CANCEL, TaskRequest(id=sensed.made()[0].task.id))
    sensed.restart(one)
    sensed.senses(27.0, 27.0)
    assert len(sensed.made()) == 1  # the plume is still there, though the task has ended
    sensed.team.run(61.0)
    sensed.senses(20.0)
    sensed.restart(one)
    sensed.senses(27.0)
    assert len(sensed.made()) == 2  # it was armed again before the restart


def test_cooldown_and_open_tasks_outlast_a_restart(begin):
    one = rule(cooldown_s=30.0, max_open=1)
    sensed = begin(one)
    sensed.senses(27.0)
    sensed.restart(one)
    sensed.senses(27.0, mote="m2")
    sensed.team.run(30.0)
    sensed.senses(27.0, mote="m2")
    assert len(sensed.made()) == 1  # the first one is still open
    sensed.team.ask(TASK_CANCEL, TaskRequest(id=sensed.made()[0].task.id))
    sensed.senses(27.0, mote="m2")
    assert len(sensed.made()) == 2
    sensed.team.ask(TASK_CANCEL, TaskRequest(id=sensed.made()[1].task.id))
    sensed.restart(one)
    sensed.senses(27.0, mote="m3")
    assert len(sensed.made()) == 2  # 30 s have not passed


def test_an_event_told_again_after_a_restart_makes_no_second_task(begin):
    one = rule(event={"plugin": "monitor", "event": "changed"}, cooldown_s=0.0, max_open=10)
    sensed = begin(one)
    stamp_ns = sensed.team.clock.now_ns()
    sensed.notify({}, stamp_ns=stamp_ns, run_s=1.0)
    sensed.restart(one)
    sensed.team.run(1.0)
    sensed.notify({}, stamp_ns=stamp_ns, run_s=1.0)
    assert len(sensed.made()) == 1


def test_alarms_of_rules_that_are_gone_leave_the_journal(begin):
    sensed = begin(rule(), rule("other"))
    sensed.senses(27.0)
    assert {alarm.rule for alarm in sensed.journal.alarms()} == {"heat", "other"}
    sensed.restart(rule("other"))
    assert {alarm.rule for alarm in sensed.journal.alarms()} == {"other"}


@pytest.mark.slow
def test_a_flood_of_readings_costs_bounded_work_and_memory(begin):
    sensed = begin(rule(cooldown_s=0.0))
    desk = sensed.team.coordinator.part(TaskRules)
    desk.tracks._capacity = 100
    for number in range(2500):
        sensed.sense(20.0, mote=f"m{number}", sequence=1)
    assert len(desk.inbox) <= 2048
    sensed.team.run(0.1)
    assert len(desk.tracks) == 100
    sensed.team.run(61.0)
    sensed.senses(27.0, mote="fresh")  # a mote that has fallen silent makes room
    assert len(sensed.made()) == 1


def first_reason(sensed, record):
    return sensed.journal.history(record.task.id)[0].reason
