"""Each scenario that comes with robrain can be run to its end, and is shown in the documentation."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from robrain import Scenario
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import TaskState
from robrain.sim.robot.robot_hardware import RobotHardware
from robrain.sim.scenarios.scenario import listed_scenarios
from robrain.sim.scenarios.scenario_file import builtin_names

pytestmark = pytest.mark.timeout(1800)

PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "scenarios.md"
README = PAGE.parents[2] / "README.md"


@pytest.mark.slow
def test_a_team_explores_its_floor_without_a_collision_and_does_its_tasks():
    scenario = Scenario.builtin("no_centre")
    result = scenario.replace(robots=3, tasks=scenario.tasks[:7]).run(until_explored=0.9)
    assert result.ended == "explored"
    assert result.collisions == 0
    assert [task.state for task in result.tasks] == [TaskState.DONE] * 7


@pytest.mark.slow
@pytest.mark.parametrize("name", builtin_names())
def test_its_team_can_reach_nearly_all_of_it_and_begins_to_explore_it_without_a_collision(name):
    scenario = Scenario.builtin(name)
    world = scenario.world()
    starts = [Point2D(robot.start.x_m, robot.start.y_m) for robot in world.robots]
    reachable = world.plan.reachable(starts, RobotHardware().radius_m)
    assert np.count_nonzero(reachable) / np.count_nonzero(~world.plan.occupied) >= 0.97
    place = world.first_place()
    assert place is not None
    assert reachable[world.plan.geometry.cell_of(place.x_m, place.y_m)]
    if name == "depot":
        assert f"place=({place.x_m:g}, {place.y_m:g})" in README.read_text(encoding="utf-8")
    run = scenario.open(world)
    try:
        while run.sim_time_s < 3.0:
            run.tick()
        assert run.explored_fraction > 0.03
        assert sum(robot.distance_m for robot in run.truth.robots) > 0.3 * len(world.robots)
        assert run.arena.collisions == 0
    finally:
        run.close()


def test_the_page_lists_size_robots_and_motes_as_they_are():
    page = PAGE.read_text(encoding="utf-8")
    for one in listed_scenarios():
        size = f"{one.width_m:g} × {one.height_m:g} m"
        assert f"| [`{one.name}`](#{one.name}) | {size} | {one.robots} | {one.motes} |" in page


def test_places_of_motes_are_kept_and_more_are_drawn(tmp_path):
    toml = '[scenario]\nname = "m"\n[floor]\nsize_m = [6.0, 4.0]\n[motes]\nplaces_m = [[1.0, 1.0], [5.0, 3.0]]\n'
    scenario = Scenario.from_toml(toml)
    places = [(mote.place.x_m, mote.place.y_m) for mote in scenario.world().motes]
    assert places == [(1.0, 1.0), (5.0, 3.0)]
    more = [(mote.place.x_m, mote.place.y_m) for mote in scenario.replace(motes=4).world().motes]
    assert more[:2] == places
    assert len(set(more)) == 4
    assert Scenario.from_toml(scenario.replace(motes=1).to_toml()).world().motes == scenario.world().motes[:1]


OF_ALL_SORTS = """
[scenario]
name = "of_all_sorts"
[floor]
size_m = [8.0, 6.0]
[team]
robots = 2
[motes]
count = 3
gateways = ["m1"]
mesh = { hops = 6 }
[[robots]]
hardware = { radius_m = 0.15 }
without = ["explore"]
[links]
range_m = 8.0
relays = ["r1", "coordinator"]
[[links.partitions]]
from_s = 30.0
groups = [["r1"], ["r2", "coordinator"]]
[[faults]]
robot = "coordinator"
kind = "kill"
at_s = 4.0
until_s = 6.0
within_s = 10.0
[[faults]]
robot = "r1"
kind = "carried_off"
on = "task_assigned"
at_s = 1.0
place_m = [2.0, 2.0]
[[tasks]]
kind = "visit"
place_m = [2.0, 2.0]
[[doors]]
from_m = [4.0, 1.4]
to_m = [4.0, 2.6]
period_s = 6.0
"""


@pytest.mark.parametrize("toml", [OF_ALL_SORTS, *(Scenario.builtin(name).toml for name in builtin_names())])
def test_a_scenario_is_the_same_after_it_was_written(toml):
    scenario = Scenario.from_toml(toml)
    again = msgspec.structs.replace(Scenario.from_toml(scenario.to_toml()), toml=toml, floor=scenario.floor)
    assert again == scenario
