"""What may stand in `[[missions]]`, and the sentences for what may not."""

import pytest

from robrain.deploy.errors import UsageError
from robrain.deploy.processes.table_files import read_rules, write_rules
from robrain.sim.errors import ScenarioError
from robrain.sim.scenarios.scenario import Scenario

ROUND = """
[[missions]]
name = "round"
parameters = { floor = 1, wait_s = 2.0 }

[[missions.steps]]
name = "gate"
task = { kind = "visit", place = "gate-{floor}", service_s = "{wait_s}" }
repeats = 2

[[missions.steps]]
name = "look"
task = { kind = "inspect", place = [1.0, 2.0], look_at = [3.0, 4.0] }
on_failure = { name = "home", parameters = { speed = "{floor}" } }

[[missions]]
name = "home"
parameters = { speed = 3 }
steps = [{ name = "dock", task = { kind = "visit", place = [0.0, 0.0], priority = "{speed}" }, on_failure = "skip" }]

[[rules]]
name = "night"
schedule = { rrule = "FREQ=DAILY" }
mission = { name = "round", parameters = { floor = 2 } }
"""


def read(tmp_path, text):
    path = tmp_path / "rules.toml"
    path.write_text(text, encoding="utf-8")
    return read_rules(path)


def test_a_file_is_read_and_written_and_read_again(tmp_path):
    tables = read(tmp_path, ROUND)
    assert [mission.name for mission in tables.missions] == ["round", "home"]
    assert tables.rules[0].mission.parameters == {"floor": 2}
    assert read_rules(write_rules(tmp_path / "again.toml", tables)) == tables


def test_a_step_comes_after_the_one_before_it_unless_it_says_which():
    text = Scenario.builtin("depot").toml + ROUND.replace("repeats = 2", "after = []")
    mission = Scenario.from_toml(text, "depot.toml").missions[0]
    gate, look = mission.steps
    assert (mission.after(gate), mission.after(look)) == ((), ("gate",))


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ('name = "round"\n', 'name = "my.round"\n', "missions[0].name: Expected `str` matching regex"),
        ('name = "gate"', 'name = "the gate"', "missions[0].steps[0].name: Expected `str` matching regex"),
        ('name = "gate"', 'name = "floor"', "step floor: expected a name that no parameter and no other step has"),
        ('name = "look"', 'name = "gate"', "step gate: expected a name that no parameter and no other step has"),
        ("repeats = 2", "repeats = -1", "missions[0].steps[0]: expected repeats >= 0, got -1"),
        ("repeats = 2", "repeat = 1", "missions[0].steps[0]: unknown key `repeat` (did you mean `repeats`?)"),
        ("repeats = 2", 'after = ["look"]', "step gate: after: expected steps above (there is none), got look"),
        ("gate-{floor}", "{level}", "step gate: task.place: expected one of {mission}, {floor}, {wait_s}, got {level}"),
        ("gate-{floor}", "{look}", "got {look}"),
        ("gate-{floor}", "{floor", "expected braces in pairs around a name"),
        ('"gate-{floor}"', "[1.0]", "mission round, step gate: task: expected place as two numbers"),
        ("wait_s = 2.0", 'wait_s = "long"', "step gate: task: service_s: Expected `float`, got `str`"),
        ('kind = "visit", place = "', 'place = "', "step gate: task: expected kind, such as visit"),
        ('kind = "visit", place = "', 'id = "x", kind = "visit", place = "', "task: expected no id, which the mission"),
        ("look_at", "look", "step look: task: a task to inspect has no look; it has"),
        ('name = "home", p', 'name = "hom", p', "step look: on_failure: there is no mission hom; known are round"),
        ("{ speed", "{ pace", "step look: on_failure: mission home has no parameter pace; it has speed"),
        ('"{floor}" } }', '"{gate}" } }', "step look: on_failure.parameters.speed: expected one of {floor}, {wait_s}"),
        ('on_failure = "skip"', 'on_failure = "retry"', "on_failure: unknown value 'retry'"),
        ('on_failure = "skip"', 'on_failure = { name = "round" }', "the missions round, home run each other"),
        ('mission = { name = "round"', 'mission = { name = "tour"', "rule night: mission: there is no mission tour"),
        ("{ floor = 2 }", "{ flor = 2 }", "rule night: mission: mission round has no parameter flor"),
        ("{ floor = 2 }", '{ floor = "{value}" }', "rule night: mission.parameters.floor: expected one of {due}"),
        ("mission = {", 'task = { kind = "visit" }\nmission = {', "rule night: expected either task or mission"),
        ('name = "home"\n', 'name = "round"\n', "expected each mission to have a name of its own, got round twice"),
    ],
)  # fmt: skip
def test_a_mistake_is_told_in_one_sentence_with_file_and_key(tmp_path, before, after, expected):
    assert before in ROUND
    with pytest.raises(UsageError) as caught:
        read(tmp_path, ROUND.replace(before, after, 1))
    text = str(caught.value)
    assert text.startswith(f"--rules {tmp_path / 'rules.toml'}: ")
    assert expected in text
    assert "\n" not in text


def test_a_scenario_with_a_wrong_mission_names_its_key():
    text = Scenario.builtin("depot").toml + ROUND.replace("repeats", "repeat")
    with pytest.raises(ScenarioError, match=r"^depot.toml: missions\[0\]\.steps\[0\]: unknown key `repeat`"):
        Scenario.from_toml(text, "depot.toml")
