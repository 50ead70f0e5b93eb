"""Rules are added, replaced and removed while the team runs; the others keep their states."""

import msgspec
import pytest

from robrain.coordinator.journal.journal import Journal
from robrain.protocol.errors import CallError
from robrain.protocol.model.rules.mission import Mission
from robrain.protocol.model.tasks.task import TaskState
from tests.coordinator.rules.sensed_team import SensedTeam, rule

HEAT = rule("heat", cooldown_s=0.0)
COLD = rule("cold", reading={"below": 10.0}, cooldown_s=0.0)
MINUTELY = {"rrule": "FREQ=MINUTELY"}
AT = {"kind": "visit", "place_m": (6.0, 4.0)}


def test_a_rule_that_is_put_makes_tasks_and_one_that_is_removed_makes_none(team):
    sensed = SensedTeam(team)
    sensed.senses(30.0)
    assert sensed.change(HEAT, COLD) == ["heat", "cold"]
    sensed.senses(30.0, 5.0)
    assert len(sensed.made("heat")) == len(sensed.made("cold")) == 1
    assert sensed.change(remove=["heat"]) == ["cold"]
    sensed.senses(20.0, 30.0, mote="m2")
    assert len(sensed.made("heat")) == 1
    assert sensed.change(remove=["cold"]) == []
    team.run(0.5)
    assert team.summary.rules is msgspec.UNSET


def test_an_event_rule_that_is_put_twice_makes_one_task_for_an_event(team):
    sensed = SensedTeam(team)
    moved = rule("moved", event={"plugin": "monitor", "event": "changed"}, cooldown_s=0.0, max_open=9)
    sensed.change(moved)
    sensed.change(remove=["moved"])
    sensed.change(moved)
    sensed.notify(1.0, run_s=1.0)
    assert len(sensed.made("moved")) == 1


def test_a_replaced_rule_has_another_threshold_and_the_others_keep_their_alarms(team):
    sensed = SensedTeam(team, HEAT, rule("frost", reading={"below": 0.0, "for_s": 3.0}))
    sensed.senses(30.0)
    sensed.senses(-5.0, mote="m2")
    assert sensed.change(rule("heat", reading={"above": 40.0})) == ["heat", "frost"]
    sensed.senses(20.0, 30.0, mote="m3")
    assert len(sensed.made("heat")) == 1
    sensed.senses(-5.0, mote="m2")  # for 3 s since before the change
    assert len(sensed.made("frost")) == 1
    assert sensed.status("frost").made == 1


def test_a_rule_keeps_its_cooldown_when_another_is_changed(team):
    sensed = SensedTeam(team, rule("heat", cooldown_s=60.0, max_open=9))
    sensed.senses(30.0)
    sensed.change(COLD)
    sensed.senses(30.0, mote="m2")
    assert len(sensed.made("heat")) == 1
    team.run(60.0)
    sensed.senses(30.0, mote="m3")
    assert len(sensed.made("heat")) == 2


def test_changes_survive_a_restart_with_their_alarms(team):
    sensed = SensedTeam(team, HEAT, rule("gone"))
    sensed.change(COLD, remove=["gone"])
    sensed.senses(5.0)
    sensed.restart(HEAT, rule("gone"))
    assert sensed.change() == ["heat", "cold"]
    sensed.senses(5.0)  # still in alarm
    assert len(sensed.made("cold")) == 1
    assert sensed.change(rule("gone")) == ["heat", "gone", "cold"]


def test_names_that_only_changes_had_are_forgotten(team):
    sensed = SensedTeam(team, HEAT)
    for number in range(3):
        sensed.change(rule(f"r{number}"))
        sensed.change(remove=[f"r{number}"])
    sensed.change(remove=["heat"])
    assert sensed.journal.part_states["TaskRules"]["rules"] == {"heat": None}


def test_a_change_that_cannot_be_is_refused_as_a_whole(team):
    sensed = SensedTeam(team, HEAT)
    with pytest.raises(CallError, match="there is no rule cold; known are heat"):
        sensed.change(rule("new"), remove=["cold"])
    with pytest.raises(CallError, match="got cold twice"):
        sensed.change(COLD, COLD)
    with pytest.raises(CallError, match="rule new: mission: there is no mission round; known are none"):
        sensed.change(rule("new", mission={"name": "round"}))
    assert sensed.change() == ["heat"]


def test_a_schedule_that_is_put_keeps_its_time_when_other_rules_change(team):
    sensed = SensedTeam(team)
    tour = rule("tour", schedule=MINUTELY, task=AT, cooldown_s=0.0, max_open=9)
    sensed.change(tour)
    team.run(1.0)
    made = len(sensed.made("tour"))
    team.run(60.0)
    assert len(sensed.made("tour")) == made + 1
    sensed.change(tour, HEAT)
    sensed.restart()
    team.run(1.0)
    assert len(sensed.made("tour")) == made + 1
    assert sensed.status("tour").next_ns > team.clock.now_ns()


# -- missions ---------------------------------------------------------------------------------------------------------

ROUND = msgspec.convert(
    {
        "name": "round",
        "parameters": {"mote": "m0", "x_m": 6.0},
        "steps": [{"name": "look", "task": {"kind": "visit", "place": ["{x_m}", 4.0]}}],
    },
    Mission,
)


def started(sensed):
    """Ids, requesters and parameters of the missions."""
    found = sensed.journal.part_states.get("Missions", {}).get("missions", {})
    return [(one["by"], one["parameters"]) for one in found.values()]


def test_a_rule_starts_a_mission_and_waits_for_its_end(team):
    order = {"name": "round", "parameters": {"mote": "{mote}", "x_m": "{x_m}"}}
    sensed = SensedTeam(team, rule("heat", mission=order, cooldown_s=0.0), missions=[ROUND])
    sensed.senses(30.0)
    assert started(sensed) == [("rule:heat", {"mote": "m1", "x_m": 6.5})]
    status = sensed.status()
    assert status.waits.endswith("then mission round")
    assert (status.made, status.open) == (1, 1)
    sensed.senses(30.0, mote="m2")
    assert len(started(sensed)) == 1
    sensed.restart(rule("heat", mission=order, cooldown_s=0.0))
    team.run(1.0)
    assert sensed.status().open == 1
    sensed.senses(30.0, mote="m3")
    assert len(started(sensed)) == 1
    sensed.robot.end(TaskState.DONE)
    team.run(1.0)
    sensed.senses(30.0, mote="m4")
    assert [parameters["mote"] for _, parameters in started(sensed)] == ["m1", "m4"]


@pytest.mark.parametrize("copied", [False, True])
def test_a_mission_of_a_rule_is_stored_with_the_reading_that_started_it(team, copied):
    """A copy of the journal has both, or neither."""
    journal = Journal()
    entries = []
    journal.on_written = entries.append
    sensed = SensedTeam(team, rule("heat", mission={"name": "round"}), missions=[ROUND], journal=journal)
    sensed.sense(30.0)
    team.run(0.1)
    both = [entry for entry in entries if entry.alarms and not entry.only_alarms]
    assert [[*entry.parts] for entry in both] == [["Missions"]]
    if copied:
        copy = Journal()
        copy.follow(entries)
        sensed.journal = copy
    sensed.restart(rule("heat", mission={"name": "round"}))
    sensed.senses(30.0)
    assert len(started(sensed)) == 1


def test_a_mission_that_cannot_start_is_reported_by_its_rule(team):
    order = {"name": "round", "parameters": {"x_m": "{mote}"}}
    sensed = SensedTeam(team, rule("heat", mission=order), missions=[ROUND])
    sensed.senses(30.0)
    status = sensed.status()
    assert (status.made, status.refused) == (0, 1)
    assert status.why.startswith("mission round, step look: task: place.x_m: ")


def test_a_mission_that_needs_the_place_of_a_reading_is_not_started_without(team):
    order = {"name": "round", "parameters": {"x_m": "{x_m}"}}
    sensed = SensedTeam(team, rule("heat", mission=order), missions=[ROUND])
    sensed.senses(30.0, place=None)
    assert sensed.status().why.endswith("the mote does not know where it is")
