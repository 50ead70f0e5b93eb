"""Recovery: `kill -9` and SIGSTOP of each process of a team under `robrain up`, in turn.

Noticed is the time from the signal until `up` says that the part has failed; well is the time until the part does its
work again, as another process of the team sees it. Tasks are submitted before and after each signal: each that was
acknowledged has to be in the journal at the end.
"""

import json
import os
import queue
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from robrain.deploy.supervision.part import COORDINATOR, STAND_BY
from robrain.lab.bench.figure import Figure, at_most, timing
from robrain.protocol.access.identity import read_identity
from robrain.protocol.clock import LiveClock
from robrain.protocol.errors import CallError, NobodyThere
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.messages.tasks.task_messages import TASK_LIST, TASK_SUBMIT, TaskFilter, TaskSubmission
from robrain.protocol.messages.team.arena_messages import ARENA_TRUTH
from robrain.protocol.messages.team.recorder_messages import RECORDER_STATE
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE, COORDINATOR_WHO
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_session
from robrain.protocol.workers import OwnedThread
from tests.bench.processes import LOOPBACK, ROBRAIN, running, show

PARTS = ("r1", "coordinator", "stand-by", "recorder", "dashboard", "arena", "hub")
SIGNALS = {"kill -9": signal.SIGKILL, "SIGSTOP": signal.SIGSTOP}
NOTICED_S = {"kill -9": 1.0, "SIGSTOP": 7.0}
"""Bounds. A process that hangs is silent for 5 s before it is killed, the hub for 3 s."""
WELL_S = {"kill -9": 10.0, "SIGSTOP": 16.0}
PATIENCE_S = 120.0
ASK_S = 1.0
POLL_S = 0.01
PLACE = Point2D(1.0, 1.0)


class Recovered(NamedTuple):
    """What became of one signal."""

    part: str
    signal: str
    noticed_s: float
    well_s: float


class RecoveryTeam:
    """A team under `robrain up`, and another process that sees how it is.

    Args:
        process: `robrain up --json`.

    """

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        self.acknowledged: list[str] = []
        """Tasks that the coordinator has acknowledged."""
        self.pids: dict[str, int] = {}
        self.page = ""
        self.result: dict[str, Any] = {}
        self._up: set[str] = set()
        self._lines: queue.SimpleQueue[tuple[float, str]] = queue.SimpleQueue()
        self._failed_s: dict[str, float] = {}
        self._reader = OwnedThread("lines", self._read)
        hub: dict[str, str] = {}

        def found_hub() -> bool:
            nonlocal hub
            hub = hub or next((event for event in self._events() if event["event"] == "hub"), {})
            return bool(hub)

        self._until(found_hub, "no hub")
        identity = read_identity(Path(hub["tls"])) if "tls" in hub else None
        self.session = open_session(connect=[hub["endpoint"]], wait_s=PATIENCE_S, identity=identity)
        self.wire = Endpoint(self.session, "default", LiveClock(), Drive.LIVE)
        self._inbox = Inbox(every=True)
        for topic in (ARENA_TRUTH, COORDINATOR_STATE, RECORDER_STATE, ROBOT_STATE):
            self.wire.subscribe(self._inbox, topic)
        self._until(lambda: self._note_events() or set(PARTS) <= self._up, "the team does not come up")
        for part in PARTS:
            self._until(self._is_well(part, time.time_ns()), f"{part} is not well")

    def strike(self, part: str, name: str) -> Recovered:
        """Send a signal to a part, and wait until it is well again."""
        self.submit()
        victim = self._role(part)
        pid = self.pids[victim]
        self._failed_s.pop(victim, None)
        self._up.discard(victim)
        began_s = time.monotonic()
        os.kill(pid, SIGNALS[name])
        self._until(lambda: self._note_events() or victim in self._failed_s, f"nobody noticed that {part} has failed")
        noticed_s = self._failed_s[victim] - began_s
        if part != COORDINATOR:  # whose work the one that stands by does meanwhile
            self._until(lambda: self._note_events() or victim in self._up, f"{part} is not up again")
        self._until(self._is_well(part, time.time_ns()), f"{part} is not well again")
        well_s = time.monotonic() - began_s
        self._until(lambda: self._note_events() or victim in self._up, f"{part} is not up again")
        self.submit()
        return Recovered(part, name, noticed_s, well_s)

    def _role(self, part: str) -> str:
        """The part whose process has a role now: that of the coordinator goes from one to the other."""
        if part not in (COORDINATOR, STAND_BY):
            return part
        coordinates = 0

        def found() -> bool:
            nonlocal coordinates
            with suppress(CallError, NobodyThere):
                coordinates = self.wire.ask(COORDINATOR_WHO, timeout_s=ASK_S).pid
            return bool(coordinates)

        self._until(found, "nobody coordinates")
        is_swapped = self.pids[STAND_BY] == coordinates
        return {COORDINATOR: STAND_BY, STAND_BY: COORDINATOR}[part] if is_swapped else part

    def submit(self) -> None:
        """Submit a task, again until it is acknowledged."""
        name = f"t{len(self.acknowledged) + 1}"
        asked = TaskSubmission(task=Task(id=name, kind="visit", place=PLACE))

        def is_acknowledged() -> bool:
            try:
                self.wire.ask(TASK_SUBMIT, asked, timeout_s=ASK_S)
            except NobodyThere:
                return False
            except CallError:  # no reply in time, or it was taken in by the first question
                return name in (self._listed() or ())
            return True

        self._until(is_acknowledged, f"{name} is never acknowledged")
        self.acknowledged.append(name)

    def lost(self) -> list[str]:
        """Tasks that were acknowledged and that the coordinator does not know."""
        listed: set[str] | None = None

        def found() -> bool:
            nonlocal listed
            listed = self._listed()
            return listed is not None

        self._until(found, "the coordinator does not list its tasks")
        return [name for name in self.acknowledged if listed is None or name not in listed]

    def close(self) -> None:
        """Stop the team, and read its result."""
        self.wire.close()
        self.session.close()  # type: ignore[no-untyped-call]
        self.process.send_signal(signal.SIGTERM)
        self.process.wait(PATIENCE_S)
        self._reader.close(PATIENCE_S)
        self._note_events()

    def _is_well(self, part: str, since_ns: int) -> Callable[[], bool]:
        """Whether a part has done its work since a moment."""
        self._inbox.drain()
        if part == "dashboard":
            return self._page_answers
        if part == "stand-by":
            return lambda: True  # it has said so itself; its work is to wait
        topics = {"coordinator": COORDINATOR_STATE, "arena": ARENA_TRUTH, "recorder": RECORDER_STATE}
        wanted = [topics.get(part, ROBOT_STATE)] if part != "hub" else [ROBOT_STATE, COORDINATOR_STATE, ARENA_TRUTH]
        heard = set()

        def is_well() -> bool:
            for received in self._inbox.drain():
                if received.topic is ROBOT_STATE and part not in ("hub", received.message.robot):
                    continue
                if received.message.stamp_ns >= since_ns:
                    heard.add(received.topic.name)
            is_heard = all(topic.name in heard for topic in wanted)
            return is_heard and (part not in ("coordinator", "hub") or self._listed() is not None)

        return is_well

    def _listed(self) -> set[str] | None:
        try:
            return {record.task.id for record in self.wire.ask(TASK_LIST, TaskFilter(), timeout_s=ASK_S)}
        except (CallError, NobodyThere):
            return None

    def _page_answers(self) -> bool:
        with suppress(OSError), socket.create_connection(("127.0.0.1", urlsplit(self.page).port or 0), ASK_S):
            return True
        return False

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put((time.monotonic(), line))

    def _events(self) -> Iterator[dict[str, Any]]:
        while not self._lines.empty():
            at_s, line = self._lines.get()
            if not line.startswith("{"):
                continue
            event = json.loads(line)
            if event["event"] == "part":
                self._record_part(event, at_s)
            elif event["event"] == "dashboard":
                self.page = event["url"]
            elif event["event"] == "result":
                self.result = event
            yield event

    def _note_events(self) -> None:
        for _ in self._events():
            pass

    def _record_part(self, event: dict[str, Any], at_s: float) -> None:
        part, kind = event["part"], event["kind"]
        if kind == "started":
            self.pids[part] = event["pid"]
        elif kind in ("up", "up_again"):
            self._up.add(part)
        else:
            self._failed_s.setdefault(part, at_s)

    def _until(self, condition: Callable[[], object], what: str) -> None:
        ends_s = time.monotonic() + PATIENCE_S
        while not condition():
            if time.monotonic() > ends_s or self.process.poll() is not None:
                raise TimeoutError(what)
            time.sleep(POLL_S)


@contextmanager
def recovery_team(folder: Path, *, secured: bool = False, robots: int = 2) -> Iterator[RecoveryTeam]:
    """A team for the duration of the block; a secured one has its router in place of the hub."""
    words = ("up", "arena_small", "--robots", f"{robots}", "--stand-by", "--record", str(folder / "recovery.mcap"))
    words += ("--secured",) if secured else ("--listen", LOOPBACK)
    words += ("--port", "0", "--journal", str(folder / "recovery.journal"), "--json")
    with (
        running(*ROBRAIN, *words, cwd=folder, stdout=subprocess.PIPE) as process,
        closing(RecoveryTeam(process)) as team,
    ):
        yield team


def measure() -> Iterator[Figure]:
    """Each part killed, then each stopped: of a plain team, then of a secured one."""
    for is_secured, prefix in ((False, ""), (True, "secured, ")):
        with tempfile.TemporaryDirectory() as name, recovery_team(Path(name), secured=is_secured) as team:
            for what in SIGNALS:
                for part in PARTS:
                    found = team.strike(part, what)
                    yield timing(f"{prefix}{what} of {part}: noticed", found.noticed_s, "s", at_most(NOTICED_S[what]))
                    yield timing(f"{prefix}{what} of {part}: well again", found.well_s, "s", at_most(WELL_S[what]))
            lost, count = len(team.lost()), len(team.acknowledged)
            yield timing(f"{prefix}tasks acknowledged and lost", lost, "", at_most(0), f"of {count}")


if __name__ == "__main__":
    show("Recovery", list(measure()))
