"""`kill -9` at any instant: between any two statements the process ends, and what is on disk is opened again.

The end of a process is played by copying the journal's files as they are, which is what a kill leaves in the operating
system's hands; the connection that wrote them is abandoned without a close.
"""

import shutil
import sqlite3
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.coordinator.journal import journal as journal_module
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.tasks.task_book import LEGAL, TaskBook
from robrain.protocol.clock import VirtualClock
from robrain.protocol.messages.robots.robot_messages import TaskStatus
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.tasks.task_messages import TaskFilter
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import IsNext, LeaseRanOut, cancelled, plain

pytestmark = pytest.mark.slow

ROBOTS = ("r1", "r2", "r3")


class Killed(BaseException):
    """The process ends here."""


class Fuse:
    """Burns down by one with each statement of all connections; at 0 the process ends. None never burns."""

    def __init__(self) -> None:
        self.left: int | None = None

    def burn(self) -> None:
        if self.left is not None:
            if self.left == 0:
                raise Killed
            self.left -= 1


def connection_with(fuse: Fuse) -> type[sqlite3.Connection]:
    class Connection(sqlite3.Connection):
        def execute(self, *arguments: Any) -> sqlite3.Cursor:
            fuse.burn()
            if (
                "synchronous" in arguments[0]
            ):  # a kill takes nothing from the operating system; to wait for disks is idle
                return super().execute("PRAGMA synchronous = OFF")
            return super().execute(*arguments)

    return Connection


class Disk:
    """Where journals are; each start of a coordinator finds what the last one left."""

    def __init__(self, folder: Path) -> None:
        self.fuse = Fuse()
        self._folder = folder
        self._starts = 0
        self._abandoned: list[Journal] = []
        self._path = folder / "0" / "team.journal"

    def start(self) -> Journal:
        """What a coordinator opens that starts again; the one before has been killed."""
        self._starts += 1
        folder = self._folder / str(self._starts)
        folder.mkdir()
        for ending in ("", "-wal"):
            old = self._path.with_name(self._path.name + ending)
            if old.exists():
                shutil.copyfile(old, folder / old.name)
        self._path = folder / "team.journal"
        journal = Journal(self._path, factory=connection_with(self.fuse))
        self._abandoned.append(journal)
        return journal

    def clean_up(self) -> None:
        self.fuse.left = None
        for journal in self._abandoned:
            journal.close()
        shutil.rmtree(self._folder)


class World:
    """One coordinator after the other with the same journal; robots that remember; and somebody who hears it all."""

    def __init__(self, folder: Path) -> None:
        self.disk = Disk(folder)
        self.clock = VirtualClock()
        self.told: dict[int, TaskEvent] = {}
        """By number of the change: one that is told again says the same."""
        self.done: dict[str, int] = {}
        """Effects in the world: how often robots did a task."""
        self.said: dict[str, TaskStatus] = {}
        self.held: dict[str, TaskStatus] = {}
        """What robots are to begin after that."""
        self.before: dict[str, TaskStatus] = {}
        self.begun: list[tuple[str, int]] = []
        """Tasks that robots went on to, with their epochs."""
        self.epochs: list[int] = []
        self.answered: set[str] = set()
        """Tasks whose acceptance was answered: these must never be lost."""
        self.begin()

    def begin(self) -> None:
        self.book = TaskBook(self.clock, 0, self.receive, self.disk.start())
        self.book.republish(100)

    def receive(self, event: TaskEvent) -> None:
        self.disk.fuse.burn()  # a kill after the commit, before anybody was told
        if event.state is TaskState.OFFERED and event.change not in self.told:
            self.epochs.append(event.epoch)
        assert self.told.setdefault(event.change, event) == event

    def is_killed_in(self, do: Callable[[], None]) -> bool:
        """Do something; if the fuse burns down in it, start again."""
        try:
            do()
        except Killed:
            self.disk.fuse.left = None
            self.begin()
            return True
        return False

    def run(self, do: Callable[[], None], statements: int | None) -> None:
        """Do something, and be killed after so many statements of it."""
        self.disk.fuse.left = statements
        self.is_killed_in(do)
        self.disk.fuse.left = None

    # -- what may happen; each may be asked for again after a kill -------------------------------------------

    def submit(self, task_id: str) -> None:
        if self.book.find(task_id) is None:
            self.book.add(Task(id=task_id, kind="visit", place=Point2D(1.0, 2.0)), by="ann", asked=b"{}")
        self.answered.add(task_id)

    def offer(self, task_id: str, robot: str) -> None:
        record = self.book.find(task_id)
        if record is None or record.state is not TaskState.QUEUED or self.book.of_robot(robot) is not None:
            return
        epoch = self.book.offered(task_id, robot).epoch
        last = self.said.get(robot)
        assert last is None or epoch > last.epoch
        self.said[robot] = TaskStatus(id=task_id, epoch=epoch, state=TaskState.RUNNING)  # the offer reaches it
        self.book.move(task_id, TaskState.RUNNING)

    def offer_next(self, task_id: str, robot: str) -> None:
        """For after the task that the robot is at."""
        record, at, last = self.book.find(task_id), self.book.of_robot(robot), self.said.get(robot)
        if record is None or record.state is not TaskState.QUEUED or at is None or self.book.next_of(robot) is not None:
            return
        if last is None or (last.id, last.epoch) != (at.task.id, at.epoch) or last.state.ended:
            return
        epoch = self.book.offered(task_id, robot, IsNext(at.task.id)).epoch
        self.held[robot] = TaskStatus(id=task_id, epoch=epoch, state=TaskState.OFFERED)  # the offer reaches it

    def work(self, robot: str, state: TaskState) -> None:
        """The robot ends its task, in the world, and goes on to the next."""
        status = self.said.get(robot)
        if status is not None and not status.state.ended:
            self.done[status.id] = self.done.get(status.id, 0) + (state is TaskState.DONE)
            ended = TaskStatus(id=status.id, epoch=status.epoch, state=state, why="so it went")
            self.said[robot] = ended
            held = self.held.pop(robot, None)
            if held is not None and state is not TaskState.CANCELLED:
                self.begun.append((held.id, held.epoch))
                self.before[robot] = ended
                self.said[robot] = TaskStatus(id=held.id, epoch=held.epoch, state=TaskState.RUNNING)

    def listen(self, robot: str) -> None:
        for status in (self.before.get(robot), self.said.get(robot)):
            if status is not None:
                self.book.record_status(robot, status)

    def reconcile(self) -> None:
        """A robot that runs is at it, one that is at nothing has none."""
        for record in self.book.open:
            status = self.said.get(record.robot)
            same = status is not None and (status.id, status.epoch) == (record.task.id, record.epoch)
            held = self.held.get(record.robot)
            if held is not None and (held.id, held.epoch) == (record.task.id, record.epoch):
                continue
            if record.state is TaskState.OFFERED and same:
                self.book.move(record.task.id, TaskState.RUNNING)
            elif record.robot and not same:
                self.book.give_back(record.task.id, plain("forgotten", "words"))

    def withdraw(self, robot: str) -> None:
        """What a robot is at or holds, and the book has for another or for nobody, is taken back from it."""
        bound = [(record.task.id, record.epoch) for record in self.book.bound_to(robot)]
        held, status = self.held.get(robot), self.said.get(robot)
        if held is not None and (held.id, held.epoch) not in bound:
            del self.held[robot]
        if status is not None and not status.state.ended and (status.id, status.epoch) not in bound:
            self.work(robot, TaskState.CANCELLED)

    def lose(self, task_id: str) -> None:
        record = self.book.find(task_id)
        if record is not None and record.state is TaskState.RUNNING:
            self.book.move(task_id, TaskState.LOST_CONTACT, plain("lost_contact", "words"))
            self.book.give_back(task_id, LeaseRanOut("r1"))

    def cancel(self, task_id: str) -> None:
        record = self.book.find(task_id)
        if record is not None and not record.state.ended:
            self.book.move(task_id, TaskState.CANCELLED, cancelled("ann", ""))

    def forget(self, robot: str) -> None:
        """The robot's process is killed and starts again."""
        for kept in (self.said, self.held, self.before):
            kept.pop(robot, None)

    # -- what must hold --------------------------------------------------------------------------------------

    def check(self) -> None:
        journal = self.book.journal
        records = {record.task.id: record for record in journal.select(TaskFilter())}
        assert self.answered <= set(records), "lost"
        assert {record.task.id: record for record in self.book.open} == {
            name: record for name, record in records.items() if not record.state.ended
        }
        assert self.epochs == sorted(set(self.epochs)), "an epoch was given out twice"
        assert len(self.begun) == len(set(self.begun)), "gone on to twice"
        for robot in ROBOTS:
            assert [one.epoch for one in self.book.bound_to(robot)] == sorted(
                one.epoch for one in records.values() if one.robot == robot and not one.state.ended
            )
        for name, record in records.items():
            history = journal.history(name)
            before = None
            for line in history:
                assert line.state in LEGAL[before], (before, line)
                before = line.state
            assert before is record.state
            assert sum(line.state is TaskState.DONE for line in history) <= 1
            assert sum(line.state.ended for line in history) <= 1
            if record.state is TaskState.DONE:
                assert self.done.get(name, 0) >= 1, "nobody did it"
        for number, event in self.told.items():
            lines = {line.number: line.state for line in journal.history(event.task.id)}
            assert lines[number] is event.state, "told, and not in the journal"


SCRIPT: list[Callable[[World], None]] = [
    lambda world: world.submit("t1"),
    lambda world: world.submit("t2"),
    lambda world: world.submit("t3"),
    lambda world: world.offer("t1", "r1"),
    lambda world: world.offer_next("t2", "r1"),
    lambda world: world.work("r1", TaskState.DONE),
    lambda world: world.listen("r1"),
    World.reconcile,
    lambda world: world.work("r1", TaskState.FAILED),
    lambda world: world.listen("r1"),
    lambda world: world.offer("t2", "r2"),
    lambda world: world.lose("t2"),
    lambda world: world.offer("t2", "r3"),
    lambda world: world.work("r3", TaskState.DONE),
    lambda world: world.listen("r3"),
    lambda world: world.cancel("t3"),
]
FINISH = [*[lambda world, name=name: world.listen(name) for name in ROBOTS], World.reconcile]
WITHDRAW = [lambda world, name=name: world.withdraw(name) for name in ROBOTS]


def kills_in(world: World, script: Sequence[Callable[[World], None]], at: int) -> int:
    """Run a script with a kill at a statement; the number of kills."""
    kills, world.disk.fuse.left = 0, at
    for step in script:
        if world.is_killed_in(lambda step=step: step(world)):
            kills += 1
            for settle in FINISH:  # the coordinator starts again, hears the robots, and goes on where it was
                settle(world)
            world.check()
            step(world)  # whoever asked and got no answer asks again
    world.disk.fuse.left = None
    return kills


def test_a_kill_between_any_two_statements_loses_nothing_and_does_nothing_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(journal_module, "EPOCH_BLOCK", 2)
    at, was_killed = 0, True
    while was_killed:
        folder = tmp_path / str(at)
        folder.mkdir()
        world = World(folder)
        was_killed = kills_in(world, SCRIPT, at) > 0
        for settle in [*FINISH, *WITHDRAW]:
            settle(world)
        world.check()
        states = {record.task.id: record.state for record in world.book.journal.select(TaskFilter())}
        assert (set(states), states["t1"], states["t3"]) == (
            {"t1", "t2", "t3"}, TaskState.DONE, TaskState.CANCELLED,
        )  # fmt: skip
        assert world.done["t1"] == 1
        assert (states["t2"] is TaskState.DONE) == (world.done.get("t2", 0) == 1)
        if not was_killed:
            assert states["t2"] is TaskState.DONE
        world.disk.clean_up()
        at += 1
    assert at > 80


def test_a_kill_while_the_journal_is_made_or_migrated_leaves_one_that_opens(tmp_path: Path) -> None:
    for at in range(60):
        folder = tmp_path / str(at)
        folder.mkdir()
        disk = Disk(folder)
        disk.fuse.left = at
        try:
            disk.start()
        except Killed:
            disk.fuse.left = None
            journal = disk.start()
            assert journal.opening_report == []
            assert journal.open_records() == []
        disk.clean_up()


NAMES, ROBOT = st.sampled_from(["t1", "t2", "t3", "t4"]), st.sampled_from(ROBOTS)
KILLS = st.one_of(st.none(), st.integers(0, 12))
"""Number of statements after which the process is killed; None: never."""
ENDS = st.sampled_from([TaskState.DONE, TaskState.FAILED, TaskState.CANCELLED])
ACTIONS = st.one_of(
    *(st.tuples(st.just(do), KILLS, NAMES) for do in (World.submit, World.lose, World.cancel)),
    *(st.tuples(st.just(do), KILLS, NAMES, ROBOT) for do in (World.offer, World.offer_next)),
    st.tuples(st.just(World.listen), KILLS, ROBOT),
    st.tuples(st.just(World.reconcile), KILLS),
    *(st.tuples(st.just(do), st.none(), ROBOT) for do in (World.withdraw, World.forget)),
    st.tuples(st.just(World.work), st.none(), ROBOT, ENDS),
    st.tuples(st.just(World.begin), st.none()),
)


@settings(max_examples=12, deadline=None)
@given(actions=st.lists(ACTIONS, min_size=10, max_size=25))
def test_nothing_is_lost_or_done_twice_in_any_order_with_a_kill_after_any_statement(
    actions: list[tuple[Any, ...]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    world = World(tmp_path_factory.mktemp("crash"))
    for do, kill, *arguments in actions:
        world.run(lambda do=do, arguments=arguments: do(world, *arguments), kill)
        world.check()
    world.disk.clean_up()
