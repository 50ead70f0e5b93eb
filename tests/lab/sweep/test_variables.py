"""What a person may write for seeds and varied keys, and how mistakes are told."""

from collections.abc import Callable
from typing import Any

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
    ("read", "words", "why"),
    [
        (read_seeds, "", "--seeds.*expected numbers and ranges"),
        (read_seeds, "1,,2", "--seeds.*got ''"),
        (read_seeds, "4..1", "--seeds.*expected a range upwards"),
        (read_seeds, "1..999999999999", "--seeds.*at most 100000 numbers"),
        (read_seeds, "1..3,2", "--seeds.*got 2 twice"),
        (read_seeds, "-1", "--seeds.*got '-1'"),
        (read_seeds, "9223372036854775808", "--seeds.*expected seeds from 0 to"),
        (read_vary, ["robots"], "--vary"),
        (read_vary, ["=1"], "--vary"),
        (read_vary, ["robots=1,,2"], "--vary"),
        (read_vary, ["robots=1", "robots=2"], "robots is varied twice"),
    ],
)
def test_a_mistake_is_refused_with_its_option(read: Callable[[Any], object], words: object, why: str) -> None:
    with pytest.raises(UsageError, match=why):
        read(words)


@pytest.mark.parametrize(
    ("option", "values"),
    [
        ("k=1..3,8", [1, 2, 3, 8]),
        ("k=0.1,1e-3", [0.1, 0.001]),
        ("k=true,false", [True, False]),
        ("k=auction,optimal", ["auction", "optimal"]),
        ('k="a,b",c', ["a,b", "c"]),
        ("k=[1, 2],[3, 4]", [[1, 2], [3, 4]]),
    ],
)
def test_values_are_toml_or_plain_texts(option: str, values: list[object]) -> None:
    assert read_vary([option]) == {"k": values}


@pytest.mark.parametrize(
    ("key", "full"),
    [
        ("robots", "team.robots"),
        ("strategy", "planning.exploration"),
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
        ("scenario.name", "it does not change what a run does"),
    ],
)
def test_an_unknown_key_is_refused_with_those_that_there_are(key: str, why: str) -> None:
    with pytest.raises(UsageError, match=f"--vary {key}: {why}"):
        full_key(key)


def test_values_are_set_in_a_copy() -> None:
    changed = with_values(DEPOT, {"robot.lidar.noise_m": 0.05, "team.robots": 7})
    assert (value_at(changed, "robot.lidar.noise_m"), value_at(changed, "team.robots")) == (0.05, 7)
    assert value_at(DEPOT, "team.robots") == 4
