"""The same floor explored live by kinds of robots: `python -m tests.bench.real_robots`, half an hour.

A stock robot; one with a differential base by DBC and an LD19 on a pty; a ROS 2 node; and all three in one team, which
does a task each at the end. Real processes in real time. It needs ROS 2, `pip install 'robrain[ros2]'`.
"""

import argparse
import tempfile
import time
from contextlib import closing
from pathlib import Path

from rich.console import Console

from robrain.client.team import Team
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import TaskState
from robrain.sim.scenarios.scenario import Scenario
from tests.ros_domain import Domain
from tests.system.conftest import Commands
from tests.system.ros2.mixed_team import Kind, MixedTeam

TEAMS = {
    "stock": (Kind.STOCK,),
    "differential base by DBC, LD19 on a pty": (Kind.DESCRIBED,),
    "ROS 2": (Kind.ROS2,),
    "all three": (Kind.STOCK, Kind.DESCRIBED, Kind.ROS2),
}
LOOK_S = 0.5
TASK_S = 300.0


def floor_of(name: str) -> str:
    """The table `[floor]` of a scenario that comes with robrain."""
    text = Scenario.builtin(name).toml
    begin = text.index("[floor]")
    end = text.index("\n[team]", begin)
    return text[begin:end]


def explored_after_s(team: Team, area_m2: float, limit_s: float) -> float | None:
    """How long it takes until so much is known; None if it takes too long."""
    began_s = time.monotonic()
    while (elapsed_s := time.monotonic() - began_s) < limit_s:
        if team.state().known_area_m2 >= area_m2:
            return elapsed_s
        time.sleep(LOOK_S)
    return None


def run(floor: str, kinds: tuple[Kind, ...], share: float, limit_s: float) -> str:
    """Explore with one team; returns what came of it."""
    world = Scenario.builtin(floor).replace(robots=3, motes=0).world()
    places = [(robot.start.x_m, robot.start.y_m) for robot in world.robots]
    plan = world.plan
    reachable = plan.reachable([Point2D(*place) for place in places], world.robots[0].radius_m)
    area_m2 = share * float(reachable.sum()) * plan.resolution_m**2
    with tempfile.TemporaryDirectory() as folder, closing(Domain()) as domain:
        commands = Commands(Path(folder))
        try:
            with (
                MixedTeam(commands, domain, floor_of(floor), places, kinds) as mixed,
                Team.connect(mixed.endpoint) as team,
            ):
                took_s = explored_after_s(team, area_m2, limit_s)
                known_m2 = team.state().known_area_m2
                if took_s is None:
                    return f"{known_m2:.0f} of {area_m2:.0f} m² after {limit_s:.0f} s"
                tasks = [team.submit("visit", place=place) for place in places[: len(kinds)]]
                done = sum(team.wait(task, timeout_s=TASK_S).state is TaskState.DONE for task in tasks)
                lost = [state for number in range(len(kinds)) if (state := team.state(f"r{number + 1}")).lost]
                return (
                    f"{area_m2:.0f} m² after {took_s:.0f} s, {done} of {len(tasks)} tasks done, {len(lost)} robots lost"
                )
        finally:
            commands.stop_all()


def main() -> None:
    """Run the teams one after the other."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--floor", default="hospital", help="a scenario that comes with robrain")
    parser.add_argument("--share", type=float, default=0.8, help="of the floor that is to be known")
    parser.add_argument("--teams", default=",".join(map(str, range(1, 1 + len(TEAMS)))), help="numbers of teams")
    parser.add_argument("--limit-s", type=float, default=900.0)
    wanted = parser.parse_args()
    names, console = list(TEAMS), Console(soft_wrap=True)
    for number in wanted.teams.split(","):
        name = names[int(number) - 1]
        console.print(f"{wanted.floor}, {name}: {run(wanted.floor, TEAMS[name], wanted.share, wanted.limit_s)}")


if __name__ == "__main__":
    main()
