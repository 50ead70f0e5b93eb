"""A live team whose coordinator or agents are killed again and again: does every task end, and once?

`python -m tests.system.soak --of coordinator --kills 200` (and `--of agent --kills 100`) is what `make soak` runs; the
tests run a few. Arena, coordinator and agents are real processes; `kill -9` comes at seeded random instants, during
start-up included, while tasks are being submitted. At the end the journal is read, and what the robots said.
"""

import argparse
import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import zenoh

from robrain import Team
from robrain.coordinator.journal.journal import Journal
from robrain.protocol.clock import LiveClock
from robrain.protocol.errors import CallError, NobodyThere
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.messages.tasks.task_messages import TaskFilter
from robrain.protocol.messages.team.arena_messages import ARENA_TRUTH
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_session

SCENARIO = "arena_small"
PLACES = [(1.0, 1.0), (2.0, 1.0), (1.0, 2.8), (2.2, 3.0), (4.0, 1.0), (4.2, 3.0), (3.6, 4.8), (4.0, 5.3), (6.0, 3.0)]
"""Free floor of `arena_small`, metres."""
OPEN_TASKS = 5
"""So many are to be open at a time."""
LONGEST_S = 4.0
"""A kill comes after at most so long."""
STANDS_S = 0.8
"""A robot whose agent was killed stands after this: the firmware's watchdog has stopped its wheels."""
HEAR_S = 30.0
"""What is on its way is heard after so long at the latest."""
END_S = 300.0
"""The last tasks have so long to end once nothing is killed any more."""


class Process:
    """One `robrain` process, which may be killed and started again."""

    def __init__(self, folder: Path, name: str, *words: str) -> None:
        self.name = name
        self._folder, self._words = folder, words
        self._log = (folder / f"{name}.log").open("ab")
        self.start()

    def start(self) -> None:
        variables = {key: value for key, value in os.environ.items() if not key.startswith("ROBRAIN_")}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "robrain.cli", *self._words],
            cwd=self._folder, env=variables, stdout=self._log, stderr=self._log,
        )  # fmt: skip

    def said(self) -> str:
        return (self._folder / f"{self.name}.log").read_text(errors="replace")

    def wait_for(self, pattern: str, timeout_s: float = 180.0) -> re.Match[str]:
        ends_s = time.monotonic() + timeout_s
        while time.monotonic() < ends_s:
            if found := re.search(pattern, self.said()):
                return found
            time.sleep(0.05)
        raise AssertionError(f"{self.name} never said {pattern!r}: {self.said()[-2000:]}")

    def kill(self) -> None:
        assert self.process.poll() is None, f"{self.name} has ended by itself: {self.said()[-2000:]}"
        self.process.kill()
        self.process.wait()

    def stop(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            try:
                self.process.wait(30)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self._log.close()


class Ears:
    """Hears how tasks end in the world: what robots say in their states, whoever else listens."""

    def __init__(self, session: zenoh.Session) -> None:
        self.wire = Endpoint(session, "default", LiveClock(), Drive.LIVE)
        self.done: set[tuple[str, str, int]] = set()
        """Robot, task, epoch."""
        self._inbox = Inbox(100_000, every=True)
        self.wire.subscribe(self._inbox, ROBOT_STATE)
        self.wire.subscribe(self._inbox, ARENA_TRUTH)
        self.poses: dict[str, Pose2D] = {}
        """Where the robots really are."""

    def hear(self) -> None:
        for received in self._inbox.drain():
            if received.topic is ARENA_TRUTH:
                self.poses = {robot.robot: robot.pose for robot in received.message.robots}
                continue
            state = received.message
            for status in (state.task_before, state.task):  # the next may begin in the step in which one ends
                if status is not None and status.state is TaskState.DONE:
                    self.done.add((state.robot, status.id, status.epoch))

    def place_of(self, robot: str) -> Pose2D:
        """Where a robot really is, as soon as that was heard."""
        ends_s = time.monotonic() + HEAR_S
        while robot not in self.poses and time.monotonic() < ends_s:
            self.listen(0.1)
        return self.poses[robot]

    def hear_of_all(self, names: set[str]) -> None:
        """Hear until every one of these tasks was told to be done: what a robot says comes when it comes."""
        ends_s = time.monotonic() + HEAR_S
        while not names <= {name for _, name, _ in self.done} and time.monotonic() < ends_s:
            self.listen(0.1)

    def listen(self, duration_s: float) -> None:
        until_s = time.monotonic() + duration_s
        while time.monotonic() < until_s:
            self.hear()
            time.sleep(0.02)


def put(robot_file: Path, pose: Pose2D) -> None:
    """Tell a robot's file where it stands: an agent begins there, and how it finds out is not what is tested here."""
    text = robot_file.read_text()
    for name, value in (("x_m", pose.x_m), ("y_m", pose.y_m), ("yaw_rad", pose.yaw_rad)):
        text = re.sub(rf"(?<=\n){name} = .*", f"{name} = {value!r}", text, count=1)
    robot_file.write_text(text)


class Submitter(threading.Thread):
    """Asks for tasks all the time, so that always some are open."""

    def __init__(self, endpoint: str, seed: int) -> None:
        super().__init__(name="submitter")
        self.accepted: list[str] = []
        self.refused: list[str] = []
        self.stopping = threading.Event()
        self._endpoint, self._draw = endpoint, random.Random(seed)

    def run(self) -> None:
        number = 0
        with Team.connect(self._endpoint, by="soak", patience_s=60.0) as client:
            while not self.stopping.wait(0.05):
                try:
                    states = [state for state in TaskState if not state.ended]
                    if len(client.list(TaskFilter(states=states))) >= OPEN_TASKS:
                        continue
                    number += 1
                    place = self._draw.choice(PLACES)
                    after = (self.accepted[-1],) if self.accepted and self._draw.random() < 0.2 else ()
                    client.submit("visit", id=f"soak-{number}", place=place, after=after)
                    self.accepted.append(f"soak-{number}")
                except CallError as error:  # what it waits for may just have failed
                    self.refused.append(str(error))
                except NobodyThere:
                    continue


def soak(folder: Path, victim: str, kills: int, seed: int, robots: int = 2) -> dict[str, Any]:
    """Kill coordinator, agents or both in turn so often; returns what became of the tasks."""
    draw = random.Random(seed)
    processes: list[Process] = []
    began_s = time.monotonic()
    try:
        arena = Process(folder, "arena", "arena", SCENARIO, "--robots", str(robots), "--seed", str(seed),
                        "--listen", "tcp/127.0.0.1:0", "--robot-files", ".")  # fmt: skip
        processes.append(arena)
        endpoint = arena.wait_for(r"at (tcp/[\d.:]+), robots")[1]
        agents = [Process(folder, f"r{number}", "agent", f"r{number}.toml") for number in range(1, robots + 1)]
        coordinator = Process(folder, "coordinator", "coordinator", "--connect", endpoint, "--journal", "team.journal")
        processes += [*agents, coordinator]
        for process in agents:
            process.wait_for("is up with")
        session = open_session(connect=[endpoint])
        ears = Ears(session)
        submitter = Submitter(endpoint, seed)
        submitter.start()
        try:
            for number in range(kills):
                ears.listen(draw.uniform(0.0, LONGEST_S))
                of_agents = victim == "agent" or (victim == "both" and number % 2 == 1)
                struck = draw.choice(agents) if of_agents else coordinator
                struck.kill()
                if struck is not coordinator:
                    ears.listen(STANDS_S)
                    put(folder / f"{struck.name}.toml", ears.place_of(struck.name))
                struck.start()
                sys.stderr.write(f"\r{number + 1} of {kills} kills, {len(submitter.accepted)} tasks ")
            submitter.stopping.set()
            submitter.join(120)
            ends_s = time.monotonic() + END_S
            with Team.connect(endpoint, patience_s=60.0) as client:
                left = list(submitter.accepted)
                while left and time.monotonic() < ends_s:
                    ears.hear()
                    left = [name for name in left if not client.get(name).state.ended]
                    time.sleep(0.2)
                whys = {name: client.why(name).now for name in left}
                done = TaskFilter(states=[TaskState.DONE], limit=100_000)
                ears.hear_of_all({record.task.id for record in client.list(done)})
        finally:
            submitter.stopping.set()
            ears.wire.close()
            session.close()
    finally:
        for process in reversed(processes):
            process.stop()
    assert not whys, f"tasks that have not ended: {whys}"
    found = judge(folder / "team.journal", submitter.accepted, ears.done)
    return {"kills": kills, "of": victim, "seed": seed, "wall_time_s": round(time.monotonic() - began_s, 1),
            "refused": len(submitter.refused), **found}  # fmt: skip


def judge(path: Path, accepted: list[str], done: set[tuple[str, str, int]]) -> dict[str, Any]:
    """What must hold of the journal at the end, whatever was killed."""
    journal = Journal(path)
    try:
        assert journal.opening_report == []
        records = {record.task.id: record for record in journal.select(TaskFilter(limit=100_000))}
        missing = [name for name in accepted if name not in records]
        assert not missing, f"accepted, and lost: {missing}"
        twice, epochs = [], []
        for record in journal.select(TaskFilter(limit=100_000, own=True)):
            history = journal.history(record.task.id, 10_000)
            ends = [line.state for line in history if line.state.ended]
            if len(ends) > 1:
                twice.append(record.task.id)
            epochs += [(line.number, line.epoch) for line in history if line.state is TaskState.OFFERED]
        assert not twice, f"ended twice in the journal: {twice}"
        given = [epoch for _, epoch in sorted(epochs)]
        assert given == sorted(set(given)), "an epoch was given out twice"
        effects = Counter(name for _, name, _ in done if name in records)
        again = {name: count for name, count in effects.items() if count > 1}
        assert not again, f"done by robots more than once: {again}"
        undone = [name for name, record in records.items() if name in effects and record.state is not TaskState.DONE]
        assert not undone, f"done by robots, and not in the journal: {undone}"
        unheard = [name for name, record in records.items() if record.state is TaskState.DONE and name not in effects]
        return {
            "tasks": len(records),
            **Counter(str(record.state) for record in records.values()),
            "done_and_seen_on_the_wire": len(effects),
            "done_unseen": len(unheard),
            "offers": len(given),
        }
    finally:
        journal.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--of", choices=["coordinator", "agent", "both"], default="coordinator")
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="robrain-soak-") as folder:
        found = soak(Path(folder), given.of, given.kills, given.seed)
    sys.stdout.write(json.dumps(found) + "\n")


if __name__ == "__main__":
    main()
