"""`robrain halt ROBOT`: the robot may be given as an argument, or as an option."""

import pytest

from robrain.deploy.commands.team_commands import one_robot
from robrain.deploy.errors import UsageError


@pytest.mark.parametrize(
    ("argument", "option", "robot"), [(None, None, None), ("r1", None, "r1"), (None, "r1", "r1"), ("r1", "r1", "r1")]
)
def test_robot_is_taken_from_either(argument: str | None, option: str | None, robot: str | None) -> None:
    assert one_robot(argument, option) == robot


def test_two_robots_are_refused() -> None:
    with pytest.raises(UsageError, match="--robot r2: expected one robot, got r1 as well"):
        one_robot("r1", "r2")
