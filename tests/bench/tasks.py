"""Tasks: what the journal takes for each change, and what many tasks cost a coordinator."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from threading import Event

from robrain.coordinator.core.core import Parts
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.tasks.task_book import TaskBook
from robrain.coordinator.tasks.task_lifecycle import TaskLifecycle
from robrain.coordinator.team.capabilities import Capabilities
from robrain.coordinator.team.roster import Roster
from robrain.coordinator.team.team_map import TeamMap
from robrain.lab.bench.figure import Figure, at_most, timing
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.messages.robots.robot_messages import RobotState, TaskStatus
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.presence import Change
from robrain.protocol.wire.session import open_lockstep_session

ACCEPTED = 100
ROBOTS, TASKS = 100, 1000
STEP_S = 0.02
RESTARTS = 5


def measure() -> list[Figure]:
    """All figures; seconds of wall time, of one core."""
    with tempfile.TemporaryDirectory(prefix="robrain-bench-") as folder:
        return [*_journal(Path(folder)), *_restart(Path(folder)), *_steps()]


def _journal(folder: Path) -> list[Figure]:
    journal = Journal(folder / "changes.journal")
    book = TaskBook(VirtualClock(), 0, lambda _event: None, journal)
    is_on_disk = Event()

    def accept(name: str) -> None:
        book.add(_visit(name), asked=b"{}")
        is_on_disk.clear()
        journal.when_on_disk(lambda _error: is_on_disk.set())
        is_on_disk.wait()

    accept_ms = median(_spent_ms(lambda name=f"t{number}": accept(name)) for number in range(ACCEPTED))
    own_ms = median(_spent_ms(lambda name=f"o{number}": book.add(_visit(name), own=True)) for number in range(ACCEPTED))
    changes = []
    for number in range(ACCEPTED):
        name = f"t{number}"
        changes.append(_spent_ms(lambda name=name: book.offered(name, "r1")))
        changes.append(_spent_ms(lambda name=name: book.move(name, TaskState.RUNNING)))
        changes.append(_spent_ms(lambda name=name: book.move(name, TaskState.DONE)))
    journal.close()
    change_ms = median(changes)
    return [
        timing("a task accepted, on the disk", accept_ms, "ms", beside=f"not waiting for the disk {own_ms:.2f} ms"),
        timing("any other change of a task", 1e3 * change_ms, "µs", at_most(1000)),
    ]


def _restart(folder: Path) -> list[Figure]:
    path = folder / "many.journal"
    journal = Journal(path)
    book = TaskBook(VirtualClock(), 0, lambda _event: None, journal)
    for number in range(TASKS):
        book.add(_visit(f"t{number}"), own=number >= ACCEPTED)
    journal.close()

    def begin() -> None:
        again = Journal(path)
        TaskBook(VirtualClock(), 0, lambda _event: None, again).republish(256)
        again.close()

    duration_ms = min(_spent_ms(begin) for _ in range(RESTARTS))
    return [timing(f"a book with {TASKS} open tasks opened in", duration_ms, "ms", at_most(500))]


def _steps() -> list[Figure]:
    clock = VirtualClock()
    with open_lockstep_session() as session:
        wire = Endpoint(session, "default", clock, Drive.LOCKSTEP)
        roster = Roster()
        book = TaskBook(clock, 0, lambda _event: None)
        capabilities = Capabilities(wire)
        lifecycle = TaskLifecycle(wire, book, roster, capabilities, Parts(), TeamMap())
        for number in range(TASKS):
            book.add(_visit(f"t{number}", after=(f"t{number - 1}",) if number % 3 == 2 else ()))
        for number in range(ROBOTS):
            name = f"r{number}"
            roster.record_presence(Change({"robot": name}, True))
            capabilities.plugins[name] = frozenset({"visit"})
            record = book.offered(f"t{number * 3}", name)
            book.move(record.task.id, TaskState.RUNNING)

        def speak() -> None:
            for record in book.open[: 3 * ROBOTS]:
                if record.robot:
                    status = TaskStatus(id=record.task.id, epoch=record.epoch, state=TaskState.RUNNING)
                    pose = Pose2D(1.0, 1.0, 0.0)
                    roster.record_state(RobotState(robot=record.robot, pose=pose, task=status), clock.now_ns())

        def step() -> None:
            now_ns = clock.now_ns()
            lifecycle.settle(now_ns)
            lifecycle.withdraw_strays(now_ns)

        speak()
        steps = []
        for _ in range(20):
            clock.advance_to(clock.now_ns() + to_ns(STEP_S))
            steps.append(_spent_ms(step))
        decide_ms = median(_spent_ms(lambda: lifecycle.publish_unfit(clock.now_ns())) for _ in range(10))
        wire.close()
    step_ms = median(steps)
    team = f"{TASKS} tasks, {ROBOTS} robots"
    return [
        timing(f"{team}: a step", step_ms, "ms", at_most(2), f"a step every {1e3 * STEP_S:.0f} ms"),
        timing(f"{team}: a decision", decide_ms, "ms", at_most(20), "twice a second"),
    ]


def _visit(name: str, **fields: tuple[str, ...]) -> Task:
    return Task(id=name, kind="visit", place=Point2D(1.0, 2.0), **fields)


def _spent_ms(do: Callable[[], object]) -> float:
    began_s = time.perf_counter()
    do()
    return 1e3 * (time.perf_counter() - began_s)
