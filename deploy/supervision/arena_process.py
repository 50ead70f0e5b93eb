"""`robrain arena`: the simulator in real time."""

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Protocol

import zenoh

from robrain.deploy.agents.robot_files import (
    addresses,
    loadable_from_here,
    open_forwarders,
    open_lines,
    write_robot_files,
)
from robrain.deploy.command_line.recording_path import make_folder
from robrain.deploy.command_line.terminal import own_command, say
from robrain.deploy.processes.forwarder_words import said
from robrain.deploy.processes.live_process import LiveStop, Place, live_endpoint, open_hub, open_when_there, tell
from robrain.deploy.run.kernels import prepare_kernels
from robrain.deploy.supervision.arena_resume import resumed
from robrain.protocol.wire.session import listening_at
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.world.arena import Arena

CATCH_UP_S = 0.5


def arena_command(
    scenario: Scenario, place: Place, team: str, robot_files: Path | None, resume: Path | None = None
) -> None:
    """Simulate a scenario until Ctrl-C.

    Args:
        scenario: the scenario to simulate.
        place: where to connect or listen; without either, the arena is this machine's hub.
        team: its name.
        robot_files: folder for a ROBOT.toml of each robot.
        resume: file with the poses at which the robots go on, written by `robrain up` when an arena has ended.

    Raises:
        RobrainError: in one sentence.

    """
    world = scenario.world()
    world.check_live()
    if resume is not None:
        world = resumed(world, resume)
    prepare_kernels()
    should_stop = LiveStop()
    with ExitStack() as closing:
        session = _open(place, should_stop)
        if session is None:
            return
        closing.callback(session.close)
        wire = closing.enter_context(live_endpoint(session, team))
        where = place.connect or listening_at(session)
        forwarders = open_forwarders(wire, [robot.name for robot in world.robots], closing)
        listening, lines = addresses(forwarders), []
        if robot_files is not None:
            make_folder(robot_files)
            lines = open_lines(wire, world, robot_files, closing)
            for path in write_robot_files(
                world,
                robot_files,
                team=team,
                connect=where[0],
                forwarders=listening,
                loadable=loadable_from_here(where),
                lines=lines,
            ):
                say(own_command("agent", path))
        arena = world.arena(wire)
        try:
            names = ", ".join(robot.name for robot in world.robots)
            for robot, address in listening.items():
                tell(said(robot, address))
            tell(f"arena: {scenario.name} at {', '.join(where)}, robots {names}; Ctrl-C ends it")
            should_stop.ready()
            run_arena(arena, should_stop, [*forwarders, *lines])
        finally:
            arena.close()


def _open(place: Place, should_stop: LiveStop) -> zenoh.Session | None:
    if place.connect:
        return open_when_there("arena", place.connect, should_stop)
    session, taken = open_hub(place.listen[0] if place.listen else None)
    if taken:
        say(f"arena: {taken} is taken, listening elsewhere: other commands need --connect")
    return session


class Stepped(Protocol):
    """What lets others in: a base station's forwarder, a serial line."""

    def step(self) -> None:
        """Pass on what there is."""


def run_arena(arena: Arena, should_stop: Callable[[], bool], lines: Sequence[Stepped] = ()) -> None:
    """Step an arena, and its lines to others, in real time until `should_stop()`.

    After a pause of the machine the arena makes up for at most half a second; the rest of the time is lost to the
    simulated world, so that it does not race.
    """
    due_s = time.monotonic()
    while not should_stop():
        arena.step()
        for line in lines:
            line.step()
        due_s += arena.tick_s
        ahead_s = due_s - time.monotonic()
        if ahead_s > 0:
            time.sleep(ahead_s)
        elif ahead_s < -CATCH_UP_S:
            due_s = time.monotonic()
