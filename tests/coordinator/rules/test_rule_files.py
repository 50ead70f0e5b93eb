"""What may stand in `[[rules]]`, and the sentences for what may not."""

import pytest

from robrain.deploy.errors import UsageError
from robrain.deploy.processes.table_files import RuleTables, read_rules, write_rules
from robrain.protocol.model.rules.template import check_template, fill
from robrain.sim.errors import ScenarioError
from robrain.sim.scenarios.scenario import Scenario

READING = """[rules.reading]
quantity = "temperature_c"
above = 26.0"""
HEAT = """
[[rules]]
name = "heat"
[rules.reading]
quantity = "temperature_c"
above = 26.0
[rules.task]
kind = "seek"
parameters = { quantity = "{quantity}" }
"""


def read(tmp_path, text):
    path = tmp_path / "rules.toml"
    path.write_text(text, encoding="utf-8")
    return read_rules(path).rules


def test_a_file_is_read_and_written_and_read_again(tmp_path):
    rules = read(tmp_path, HEAT)
    assert (rules[0].name, rules[0].reading.above, rules[0].task.kind, rules[0].max_open) == ("heat", 26.0, "seek", 1)
    assert read_rules(write_rules(tmp_path / "again.toml", RuleTables(rules=rules))).rules == rules


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ("above = 26.0", "", "rules[0].reading: expected one of above, below, rising_per_min and falling_per_min, go"),
        ("above = 26.0", "above = 2.0\nbelow = 1.0", "got above and below"),
        ("above = 26.0", "above = nan", "expected above >= -1e+15, got nan"),
        ("above = 26.0", "above = 26.0\nclear_at = 27.0", "expected clear_at to be at most above = 26, got 27"),
        ("above = 26.0", "below = 26.0\nclear_at = 25.0", "expected clear_at to be at least below = 26, got 25"),
        ("above = 26.0", "rising_per_min = 0.0", "expected rising_per_min > 0, got 0"),
        ("above = 26.0", "above = 26.0\nfor = 8.0", "rules[0].reading: unknown key `for`"),
        ("above = 26.0", "above = 1.0\narea = {x_min_m = 2.0, y_min_m = 0.0, x_max_m = 1.0, y_max_m = 1.0}",
         "rules[0].reading.area: expected x_min_m below x_max_m"),
        ('name = "heat"', 'name = "too hot"', "rules[0].name: Expected `str` matching regex"),
        (READING, "", "expected one of reading, event and schedule, got none"),
        ("[rules.task]", '[rules.event]\nplugin = "p"\nevent = "e"\n[rules.task]', "got reading and event"),
        ("{quantity}", "{colour}", "rule heat: task.parameters.quantity: expected one of {quantity}, {value}"),
        ("{quantity}", "{value.__class__}", "got {value.__class__}"),
        ("{quantity}", "{value", "expected braces in pairs around a name"),
        ('quantity = "{quantity}"', "duration_s = -1.0", "task.parameters: duration_s: Expected `float` > 0.0"),
        ('quantity = "{quantity}"', "look = 1", "rule heat: task.parameters: "),
        ('quantity = "{quantity}"', "since = 2026-01-01", "got a date"),
        ('kind = "seek"', 'kind = ""', "rules[0].task: expected a kind of task, got an empty one"),
        ('kind = "seek"', 'kind = "seek"\nservice_s = 9.0\ndeadline_s = 3.0', "expected service_s of at most"),
    ],
)  # fmt: skip
def test_a_mistake_is_told_in_one_sentence_with_file_and_key(tmp_path, before, after, expected):
    assert before in HEAT
    with pytest.raises(UsageError) as caught:
        read(tmp_path, HEAT.replace(before, after))
    text = str(caught.value)
    assert text.startswith(f"--rules {tmp_path / 'rules.toml'}: rules")
    assert expected in text
    assert "\n" not in text


@pytest.mark.parametrize(
    ("text", "expected"),
    [("", "expected at least one table [[rules]]"), (HEAT + HEAT, "to have a name of its own, got heat twice")],
)  # fmt: skip
def test_what_is_wrong_with_all_rules_together(tmp_path, text, expected):
    with pytest.raises(UsageError, match=r"^--rules") as caught:
        read(tmp_path, text)
    assert expected in str(caught.value)


def test_a_scenario_with_a_wrong_rule_names_its_key():
    text = Scenario.builtin("plume").toml.replace("above = 23.0", "abov = 23.0")
    why = r"^plume.toml: rules\[0\].reading: unknown key `abov` \(did you mean `above`\?\)"
    with pytest.raises(ScenarioError, match=why):
        Scenario.from_toml(text, "plume.toml")


def test_parameters_are_filled_at_any_depth_and_keep_their_types():
    values = {"value": 27.25, "mote": "m3", "place": {"x_m": 1.0, "y_m": 2.0}}
    template = {"a": "{value}", "b": ["{mote}", 3, {"c": "{mote} at {value}"}], "look_at": "{place}", "d": True}
    check_template(template, values)
    assert fill(template, values) == {
        "a": 27.25,
        "b": ["m3", 3, {"c": "m3 at 27.25"}],
        "look_at": {"x_m": 1.0, "y_m": 2.0},
        "d": True,
    }


@pytest.mark.parametrize("nested", [lambda part: [part], lambda part: (part,), lambda part: {"a": part}])
def test_tables_and_lists_nested_deeper_than_eight_levels_are_refused(nested):
    deep: object = "x"
    for _ in range(8):
        deep = nested(deep)
    check_template(deep, {})
    with pytest.raises(ValueError, match="at most 8 levels"):
        check_template(nested(deep), {})
