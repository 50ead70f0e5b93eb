"""A small live team for measurements: hub, arena, coordinator and agents as processes of this machine."""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import NamedTuple

import zenoh

from robrain.deploy.errors import ChildFailed
from robrain.deploy.processes.arena_process import write_robot_files
from robrain.deploy.processes.children import Child, Children
from robrain.deploy.processes.live_process import ANY_PORT, open_hub
from robrain.deploy.processes.table_files import RuleTables, write_rules
from robrain.protocol.model.rules.rule import Rule
from robrain.protocol.wire.session import listening_at
from robrain.sim.scenarios.scenario import Scenario
from tests.bench.processes import wait_for

TEAM = "bench"
ROOM = """
[scenario]
name = "bench_room"
seed = 1

# One room that a robot sees whole from where it starts: nothing is left to explore after some seconds.
[floor]
size_m = [7.0, 5.0]
resolution_m = 0.05

[team]
robots = 1
"""


class HubAndChildren(NamedTuple):
    """What processes of a benchmark need."""

    folder: Path
    hub: zenoh.Session
    endpoint: str
    children: Children


@contextmanager
def hub_and_children() -> Iterator[HubAndChildren]:
    """A temporary folder, a hub in this process, and its children, which end with the block."""
    with (
        tempfile.TemporaryDirectory(prefix="robrain-bench-") as name,
        closing(open_hub(ANY_PORT)[0]) as hub,
        Children() as children,
    ):
        yield HubAndChildren(Path(name), hub, listening_at(hub)[0], children)


class LiveTeam(NamedTuple):
    """A team that runs."""

    hub: zenoh.Session
    """A session of this process that all others are clients of."""
    endpoint: str
    team: str
    children: dict[str, Child]
    """By name: arena, coordinator, and each robot."""


@contextmanager
def live_room(rules: Sequence[Rule] = ()) -> Iterator[LiveTeam]:
    """One robot in one room, with arena and coordinator, for as long as the block lasts.

    Args:
        rules: the coordinator's.

    Raises:
        ChildFailed: a process did not start.

    """
    with tempfile.TemporaryDirectory(prefix="robrain-bench-") as name:
        scenario = Path(name) / "bench_room.toml"
        scenario.write_text(ROOM, encoding="utf-8")
        room = Scenario.from_file(scenario).replace(rules=tuple(rules))
        with live_team(room, [str(scenario)]) as team:
            yield team


@contextmanager
def live_team(scenario: Scenario, scenario_argument: Sequence[str]) -> Iterator[LiveTeam]:
    """A scenario's team, with arena and coordinator, for as long as the block lasts.

    Args:
        scenario: whose robots they are.
        scenario_argument: the arguments of `robrain arena` that name the same scenario.

    Raises:
        ChildFailed: a process did not start.

    """
    with hub_and_children() as (folder, hub, endpoint, children):
        robot_files = write_robot_files(scenario.world(), folder, team=TEAM, connect=endpoint)
        common = ["--connect", endpoint, "--team", TEAM]
        kept = ["--journal", str(folder / "bench.journal")]
        if scenario.rules:
            kept += ["--rules", str(write_rules(folder / "rules.toml", RuleTables(rules=scenario.rules)))]
        started = {
            "arena": children.start("arena", ["arena", *scenario_argument, *common]),
            "coordinator": children.start("coordinator", ["coordinator", *kept, *common]),
        }
        for path in robot_files:
            started[path.stem] = children.start(path.stem, ["agent", str(path)])
        for child in started.values():
            await_ready(child)
        yield LiveTeam(hub, endpoint, TEAM, started)


def await_ready(child: Child) -> None:
    """Wait for the first line that a process says (ChildFailed if it ends before, or says nothing)."""
    wait_for(lambda: child.lines or child.status is not None, f"{child.name} printed nothing")
    if not child.lines:
        raise ChildFailed(f"{child.name} did not start")
