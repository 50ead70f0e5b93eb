"""Two coordinators with journals of their own, elected by three robots: one is lost, the other goes on by itself."""

import signal
import time
from contextlib import ExitStack

import pytest

from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.tasks.task_messages import TASK_LIST, TASK_SUBMIT, TaskFilter, TaskSubmission
from robrain.protocol.messages.team.standing_messages import COORDINATOR_LEAD, LeadRequest
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from tests.asking import until_answered
from tests.system.conftest import Commands, member_at
from tests.waiting import until

pytestmark = pytest.mark.system

ROBOTS = ("r1", "r2", "r3")
UP = "coordinator: of team default; Ctrl-C"
IN_STEP = "in step: nothing is acknowledged that is not in the copy"
ELECTED_S = 10.0
"""Measured: 2.4 to 3.1 s after kill -9, as it stands for election after 2 s of silence; the rest is for a machine that
does other work."""
PLACES = (Point2D(1.0, 1.0), Point2D(1.0, 4.5), Point2D(3.0, 1.0), Point2D(3.0, 4.0), Point2D(2.0, 3.0))


class Pair:
    """A simulated team of three, and coordinators that are started on journals of their own."""

    def __init__(self, commands: Commands, closing: ExitStack) -> None:
        self.commands = commands
        self.endpoint = commands.arena("arena_small", "--robots", "3")
        self.wire = closing.enter_context(member_at(self.endpoint))
        self._summaries = Inbox(every=True)
        self.wire.subscribe(self._summaries, COORDINATOR_STATE)
        commands.agents(*ROBOTS, options=("--votes", str(commands.folder / "votes")))

    def coordinator(self, journal: str):
        words = ("--connect", self.endpoint, "--witnesses", ",".join(ROBOTS), "--journal", journal)
        return self.commands.start("coordinator", *words)

    def leader(self, but: str = "") -> str:
        """The journal of the coordinator that leads, as its summaries say; waits until it is another than `but`."""
        found = ""

        def leads() -> bool:
            nonlocal found
            for received in self._summaries.drain():
                lead = received.message.lead
                found = "" if lead.is_suspended else lead.journal
            return found not in ("", but)

        until(leads, "no coordinator leads")
        return found

    def submit(self, number: int) -> None:
        asked = TaskSubmission(task=Task(id=f"t{number}", kind="visit", place=PLACES[number % len(PLACES)]))
        until_answered(lambda: self.wire.ask(TASK_SUBMIT, asked))

    def tasks(self) -> dict[str, TaskState]:
        records = until_answered(lambda: self.wire.ask(TASK_LIST, TaskFilter()))
        return {record.task.id: record.state for record in records}

    def until_done(self, count: int) -> None:
        """All tasks that were submitted are there, and done."""
        wanted = {f"t{number}": TaskState.DONE for number in range(count)}
        until(lambda: self.tasks() == wanted, f"expected {wanted}")


@pytest.fixture
def pair(commands):
    with ExitStack() as closing:
        yield Pair(commands, closing)
        commands.stop_all()


def test_each_takes_over_with_all_that_was_acknowledged_and_one_that_lacks_it_by_an_operators_word_only(
    pair: Pair, commands
) -> None:
    first = pair.coordinator("first.journal")
    commands.line_with(first, UP)
    leader = pair.leader()
    second = pair.coordinator("second.journal")
    commands.line_with(second, IN_STEP)
    pair.submit(0)
    pair.submit(1)
    time.sleep(1.0)  # until the witnesses have heard that the second has everything
    first.send_signal(signal.SIGKILL)
    began_s = time.monotonic()
    leader = pair.leader(but=leader)
    assert time.monotonic() - began_s < ELECTED_S
    commands.line_with(second, UP)
    pair.submit(2)  # the second goes on alone: the witnesses know that the first lacks it
    assert set(pair.tasks()) == {"t0", "t1", "t2"}

    third = pair.coordinator("first.journal")
    commands.line_with(third, IN_STEP)
    pair.submit(3)
    time.sleep(1.0)
    second.send_signal(signal.SIGSTOP)  # it hangs, and finds itself replaced once it goes on
    pair.leader(but=leader)
    commands.line_with(third, UP)
    second.send_signal(signal.SIGCONT)
    commands.line_with(second, "this one stands by")
    commands.line_with(second, IN_STEP)
    pair.submit(4)
    pair.until_done(5)

    before = pair.tasks()
    second.send_signal(signal.SIGKILL)
    second.wait()
    pair.submit(5)  # acknowledged once the witnesses have heard that the second lacks it
    third.send_signal(signal.SIGKILL)
    again = pair.coordinator("second.journal")
    reason = "this journal may lack what another coordinator has acknowledged (robrain lead)"
    commands.line_with(again, f"not elected: 0 of 3 witnesses elect it; r1, r2, r3: {reason}")
    assert until_answered(lambda: pair.wire.ask(COORDINATOR_LEAD, LeadRequest())).skipped == []
    commands.line_with(again, UP)
    assert pair.tasks().keys() == before.keys()
    pair.submit(6)
    until(lambda: pair.tasks() == {**before, "t6": TaskState.DONE}, "the task was never done")
