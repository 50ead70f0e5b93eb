"""Lockstep teams whose coordinator is killed and may return."""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

import msgspec

from robrain.client.team import Team
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.messages.tasks.consensus_messages import ROBOT_BALLOT
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.scenarios.scenario import Scenario


class Watch:
    """Counts what robots say that they did."""

    def __init__(self, run: LockstepRun) -> None:
        self._inbox = Inbox(capacity=100_000)
        self._wire = Endpoint(run.session, run._watcher.team, run.clock, Drive.LOCKSTEP)
        self._wire.subscribe(self._inbox, ROBOT_STATE)
        self._wire.subscribe(self._inbox, ROBOT_BALLOT)
        self._done: set[tuple[str, str, int]] = set()
        self.begun: set[tuple[str, str]] = set()
        self.ballots = 0
        self.largest_ballot = 0

    def look(self) -> None:
        for received in self._inbox.drain():
            message = received.message
            if received.topic is ROBOT_BALLOT:
                self.ballots += 1
                self.largest_ballot = max(self.largest_ballot, len(msgspec.json.encode(message)))
                continue
            for status in (message.task, message.task_before):
                if status is not None and not status.id.startswith(("explore", "recharge")):
                    self.begun.add((status.id, message.robot))
                    if status.state is TaskState.DONE:
                        self._done.add((status.id, message.robot, status.epoch))

    @property
    def done(self) -> Counter[str]:
        """How often each task was done."""
        return Counter(task for task, _, _ in self._done)

    def close(self) -> None:
        self._wire.close()


@contextmanager
def team_of(robots: int, seed: int = 5, *, consensus: bool = True) -> Iterator[tuple[Team, LockstepRun, Watch]]:
    """A team on a floor that it knows in part; every robot has consensus switched on, or none."""
    scenario = Scenario.builtin("arena_small").replace(robots=robots, motes=0)
    hardware = msgspec.structs.replace(scenario.hardware, consensus=consensus)
    with scenario.replace(hardware=hardware).team(seed=seed) as team:
        run = team.transport.run
        watch = Watch(run)
        yield team, run, watch
        watch.close()


def pass_time(team: Team, watch: Watch, seconds: float, until=lambda: False) -> float:
    """Seconds until the condition held; the time given if it never did."""
    start_s = team.now_s
    while team.now_s < start_s + seconds:
        team.run_for(0.1)
        watch.look()
        if until():
            break
    return team.now_s - start_s
