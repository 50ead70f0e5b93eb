"""`Hand` drives a robot of a simulated team, alone, and gives it back."""

import pytest

from robrain import CallError, ErrorCode, Hand, Scenario


@pytest.fixture(scope="module")
def team():
    with Scenario.builtin("arena_small").replace(robots=1).team(seed=3) as one:
        one.run_for(0.5)
        yield one


def test_robot_drives_for_the_time_that_is_asked_and_is_given_back(team):
    team.call("r1", "driver", "stop")
    with Hand(team, "r1") as hand:
        before = team.call("r1", "driver", "pose")["yaw_rad"]
        hand.drive(0.6, yaw_rad_s=0.5)
        turned_rad = team.call("r1", "driver", "pose")["yaw_rad"] - before
        assert 0.1 < turned_rad < 0.4
        assert team.call("r1", "driver", "acquire_hand_lease", "bob")["lease"] > 0  # the lease is free again


def test_only_one_drives_at_a_time(team):
    team.run_for(0.2)
    team.by = "ann"
    ann = Hand(team, "r1")
    team.by = "bob"
    bob = Hand(team, "r1")
    ann.move(yaw_rad_s=0.2)
    with pytest.raises(CallError, match="ann drives the robot by hand") as refusal:
        bob.move(yaw_rad_s=0.2)
    assert refusal.value.code is ErrorCode.BUSY
    ann.move()
    bob.move(yaw_rad_s=0.2)
    with pytest.raises(CallError):
        ann.move(yaw_rad_s=0.2)
    bob.move()
