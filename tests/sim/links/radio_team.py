"""A team in a corridor, whose robots stand where a test puts them."""

from dataclasses import replace

import msgspec

from robrain.client.team import Team
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.sim.lockstep.lockstep import LockstepRun, LockstepTransport
from robrain.sim.scenarios.scenario import Scenario

TEAM = "default"
CORRIDOR = """
[scenario]
name = "corridor"
[floor]
size_m = [{length_m}, 4.0]
resolution_m = 0.05
{walls}
[team]
robots = {robots}
near_m = [2.0, 2.0]
[robot.lidar]
range_max_m = 40.0
[links]
{links}
"""
Y_M = 2.0


def corridor(links, *, robots, length_m=30.0, walls=""):
    """A scenario whose floor all lidars see from the start, so that nobody explores."""
    text = CORRIDOR.format(length_m=length_m, robots=robots, links=links, walls=walls)
    return Scenario.from_toml(text, "corridor.toml")


class RadioTeam:
    """A run of a corridor with a robot at each of these distances from its west end, metres."""

    def __init__(self, links, xs_m, *, seed=1, party="", record=None, faults=(), **floor):
        scenario = corridor(links, robots=len(xs_m), **floor).replace(seed=seed, faults=faults)
        world = scenario.world()
        robots = [
            msgspec.structs.replace(robot, start=Pose2D(x_m, Y_M, 0.0))
            for robot, x_m in zip(world.robots, xs_m, strict=True)
        ]
        self.run = scenario.open(replace(world, robots=robots), record=record)
        self.team = Team(LockstepTransport(self.run, party=party), by="test")

    def wire(self, party=""):
        """An endpoint with a party's radio."""
        return Endpoint(self.run.session, TEAM, self.run.clock, Drive.LOCKSTEP, party=party)

    def hear(self, topic, party="", **names):
        """An inbox that keeps all that a party hears from now on."""
        inbox = Inbox(every=True)
        self.wire(party).subscribe(inbox, topic, **names)
        return inbox

    def go(self, until_s):
        while self.run.sim_time_s < until_s - 1e-9:
            self.run.tick()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.team.transport.close()


def robots_in(inbox):
    """Names of the robots whose messages are in an inbox."""
    return {received.message.robot for received in inbox.drain()}


def counted(run: LockstepRun):
    return msgspec.structs.asdict(run.links)
