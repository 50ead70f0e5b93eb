"""What a person may write for seeds and varied keys, and how mistakes are told."""

import pytest

from robrain import Scenario
from robrain.deploy.errors import UsageError
from robrain.lab.sweep.plan import full_key, read_seeds, read_vary, value_at, with_values

DEPOT = Scenario.builtin("depot").document()


@pytest.mark.parametrize(
    ("text", "seeds"),
    [("1..4", (1, 2, 3, 4)), ("9,1,4", (1, 4, 9)), ("1..3,10", (1, 2, 3, 10)), (" 5 , 7..8", (5, 7, 8)), ("0", (0,))],
)
def test_seeds_are_numbers_and_ranges_in_ascending_order(text: str, seeds: tuple[int, ...]) -> None:
    assert read_seeds(text) == seeds


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "expected numbers and ranges"),
        ("1-4", "got '1-4'"),
        ("1,,2", "got ''"),
        ("4..1", "expected a range upwards"),
        ("1..999999999999", "at most 100000 numbers"),
        ("1..3,2", "got 2 twice"),
        ("-1", "got '-1'"),
        ("9223372036854775808", "expected seeds from 0 to"),
    ],
)
def test_a_mistake_in_the_seeds_is_told(text: str, why: str) -> None:
    with pytest.raises(UsageError, match=f"--seeds.*{why}"):
        read_seeds(text)


@pytest.mark.parametrize(
    ("option", "values"),
    [
        ("k=1,2,4", [1, 2, 4]),
        ("k=1..3,8", [1, 2, 3, 8]),
        ("k=0.1,1e-3", [0.1, 0.001]),
        ("k=true,false", [True, False]),
        ("k=auction,optimal", ["auction", "optimal"]),
        ('k="a,b",c', ["a,b", "c"]),
        ("k=[1, 2],[3, 4]", [[1, 2], [3, 4]]),
        ("k=maps/a.yaml,maps/b.yaml", ["maps/a.yaml", "maps/b.yaml"]),
    ],
)
def test_values_are_toml_or_plain_texts(option: str, values: list[object]) -> None:
    assert read_vary([option]) == {"k": values}


@pytest.mark.parametrize("option", ["robots", "robots=", "=1", "robots=1,,2", "robots=1,"])
def test_an_option_of_another_form_is_refused(option: str) -> None:
    with pytest.raises(UsageError, match="--vary"):
        read_vary([option])


def test_a_key_that_is_varied_twice_is_refused() -> None:
    with pytest.raises(UsageError, match="robots is varied twice"):
        read_vary(["robots=1", "robots=2"])


@pytest.mark.parametrize(
    ("key", "full"),
    [
        ("robots", "team.robots"),
        ("strategy", "planning.exploration"),
        ("robot.lidar.noise_m", "robot.lidar.noise_m"),
        ("chargers", "chargers"),
        ("links.range_m", "links.range_m"),
        ("map", "map.file"),
    ],
)
def test_a_key_is_a_short_name_or_that_of_the_scenario_file(key: str, full: str) -> None:
    assert full_key(key) == full


@pytest.mark.parametrize(
    ("key", "why"),
    [
        ("robtos", r"expected one of robots, motes, .*, or TABLE\.KEY of a scenario file \(did you mean `robots`\?\)"),
        ("seed", "--seeds gives the seeds"),
        ("scenario.seed", "--seeds gives the seeds"),
        ("scenario.name", "it does not change what a run does"),
        ("scenario.about", "it does not change what a run does"),
    ],
)
def test_an_unknown_key_is_refused_with_those_that_there_are(key: str, why: str) -> None:
    with pytest.raises(UsageError, match=f"--vary {key}: {why}"):
        full_key(key)


def test_values_are_set_in_a_copy() -> None:
    changed = with_values(DEPOT, {"robot.lidar.noise_m": 0.05, "team.robots": 7})
    assert (value_at(changed, "robot.lidar.noise_m"), value_at(changed, "team.robots")) == (0.05, 7)
    assert value_at(DEPOT, "team.robots") == 4


def test_a_list_is_json_in_the_table() -> None:
    assert value_at(DEPOT, "planning.passes") == '["stability","charging_robots","early_start"]'
