"""A behavior's tasks over the wire: offers, withdrawals, the lease, and behaviors that break."""

import pytest

from robrain.protocol.clock import to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.messages.robots.witness_messages import Lead
from robrain.protocol.messages.tasks.offer_messages import ROBOT_OFFER, ROBOT_WITHDRAW, TaskAnswer, TaskWithdrawal
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE, HALT, Halt, TeamState
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.reasons import ProcessPaused
from tests.agent.explorer import offer

SEEKER = """
    from robrain.protocol.messages.tasks.offer_messages import TaskAnswer
    from robrain.protocol.model.tasks.task import TaskState

    class Seeker(Behavior):
        kind = "explore"
        period_s = 0.02
        def init(self):
            self.log, self.trouble = [], None
        def activate(self): self.env.do_tasks(self.accept, self.let_go)
        def step(self):
            self.raise_if("step")
            if self.trouble == "ends":
                self.trouble = None
                self.env.tasks.end(self.task, TaskState.DONE, "", {"n": 1})
        def accept(self, task):
            self.raise_if("accept")
            self.log.append(task.id)
            self.task = task.id
            return TaskAnswer(accepted=True)
        def let_go(self, why):
            self.raise_if("let_go")
            self.log.append(why)
        def raise_if(self, where):
            if self.trouble == where: raise RuntimeError(f"trouble in {where}")

    class Bystander(Device):
        period_s = 0.02
        steps = 0
        def step(self): self.steps += 1
"""


@pytest.fixture
def seeker(bench):
    bench.code("seeker", SEEKER)
    bench.manifest("seeker", "seeker:Seeker")
    bench.manifest("bystander", "seeker:Bystander")
    bench.start("seeker", "bystander")
    bench.coordinator = bench.wire.publisher(COORDINATOR_STATE)
    return bench


def send(bench, topic, message):
    return bench.wire.ask(topic, message, robot="r1")


def status(bench):
    inbox = Inbox()
    bench.wire.subscribe(inbox, ROBOT_STATE)
    bench.tick(6)
    return inbox.drain()[-1].message.task


def test_over_the_wire_a_task_runs_while_the_coordinator_is_heard_and_no_longer(seeker):
    assert send(seeker, ROBOT_OFFER, offer(lease_s=1.0)) == TaskAnswer(accepted=True)
    for _ in range(30):
        seeker.coordinator.put(TeamState(robots=[]))
        seeker.tick(5)
    assert status(seeker).state is TaskState.RUNNING
    seeker.tick(60)
    assert status(seeker).state is TaskState.CANCELLED
    assert seeker.plugin("seeker").log == ["t1", "the coordinator is silent, the lease ran out"]


def test_over_the_wire_a_task_can_be_withdrawn(seeker):
    send(seeker, ROBOT_OFFER, offer())
    send(seeker, ROBOT_WITHDRAW, TaskWithdrawal(id="t1", epoch=1, why="changed our minds"))
    assert seeker.plugin("seeker").log == ["t1", "changed our minds"]


def test_a_halt_that_is_over_before_the_robots_next_step_has_ended_its_task(seeker):
    send(seeker, ROBOT_OFFER, offer())
    halts = seeker.wire.publisher(HALT)
    for halted in (True, False):
        halts.put(Halt(halted=halted, by="ann"))
    assert status(seeker).state is TaskState.CANCELLED


def test_a_behavior_that_raises_over_an_offer_is_faulted_and_the_offer_refused(seeker):
    seeker.plugin("seeker").trouble = "accept"
    assert "seeker is faulted: RuntimeError: trouble in accept" in send(seeker, ROBOT_OFFER, offer()).why
    assert status(seeker) is None
    assert seeker.infos()["seeker"].state == "faulted"


def test_a_behavior_that_raises_when_it_must_let_go_takes_nobody_with_it(seeker):
    send(seeker, ROBOT_OFFER, offer(lease_s=0.1))
    seeker.plugin("seeker").trouble = "let_go"
    seeker.tick(50)
    assert status(seeker).state is TaskState.CANCELLED
    assert seeker.infos()["seeker"].why == "RuntimeError: trouble in let_go"
    assert seeker.plugin("bystander").steps >= 50


def test_the_task_of_a_behavior_that_breaks_has_failed(seeker):
    send(seeker, ROBOT_OFFER, offer())
    seeker.plugin("seeker").trouble = "step"
    assert status(seeker).state is TaskState.FAILED
    assert "no behavior does explore tasks" in send(seeker, ROBOT_OFFER, offer("t2", epoch=2)).why


def stand_still(bench, for_s):
    """Time passes without a step of the host, as where its process is stopped."""
    bench.clock.advance_to(bench.clock.now_ns() + to_ns(for_s))


@pytest.mark.parametrize("steps", [0, 1, 9])
def test_offers_that_may_have_waited_while_the_process_stood_still_are_refused(seeker, steps):
    stand_still(seeker, 0.6)
    seeker.tick(steps)
    assert send(seeker, ROBOT_OFFER, offer()) == TaskAnswer.refused(ProcessPaused())
    assert seeker.plugin("seeker").log == []


def test_offers_are_taken_again_soon_after_the_process_goes_on_and_after_short_pauses(seeker):
    stand_still(seeker, 0.6)
    seeker.tick(12)
    stand_still(seeker, 0.4)
    assert send(seeker, ROBOT_OFFER, offer()) == TaskAnswer(accepted=True)


def test_a_summary_that_may_have_waited_while_the_process_stood_still_does_not_renew_the_lease(seeker):
    send(seeker, ROBOT_OFFER, offer(lease_s=1.5))
    seeker.coordinator.put(TeamState(robots=[]))
    seeker.tick(5)
    stand_still(seeker, 1.2)
    for _ in range(2):
        seeker.coordinator.put(TeamState(robots=[]))
        seeker.tick(1)
    seeker.tick(20)
    assert seeker.plugin("seeker").log == ["t1", "the coordinator is silent, the lease ran out"]


def test_summaries_of_a_coordinator_that_was_replaced_do_not_renew_the_lease(seeker):
    send(seeker, ROBOT_OFFER, offer(lease_s=1.0))
    for election in (5, *[4] * 12):
        seeker.coordinator.put(TeamState(robots=[], lead=Lead(election=election, journal="a")))
        seeker.tick(5)
    assert seeker.plugin("seeker").log == ["t1", "the coordinator is silent, the lease ran out"]


def test_end_and_beginning_are_told_in_one_message_in_the_step_of_the_end(seeker):
    send(seeker, ROBOT_OFFER, offer("t1", 1))
    send(seeker, ROBOT_OFFER, offer("t2", 2, after="t1"))
    states = Inbox(every=True)
    seeker.wire.subscribe(states, ROBOT_STATE)
    seeker.tick(6)
    last = states.drain()[-1].message
    assert (last.task.id, last.next_task.id, last.task_before) == ("t1", "t2", None)
    seeker.plugin("seeker").trouble = "ends"
    seeker.tick(1)
    (told,) = [received.message for received in states.drain()]
    assert (told.task.id, told.task.state, told.next_task) == ("t2", TaskState.RUNNING, None)
    assert (told.task_before.id, told.task_before.state, told.task_before.result) == ("t1", TaskState.DONE, {"n": 1})
    assert seeker.plugin("seeker").log == ["t1", "t2"]
