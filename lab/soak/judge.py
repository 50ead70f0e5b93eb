"""Judges a run of points while it runs: invariants that hold under all faults.

The judge sees more than any component: bodies, books, processes and the wire at every tick. It allows what the design
allows: a robot that is cut off works on until its lease has run out, and a coordinator gives its task away after that.
The judges of recordings (`robrain check`) judge the same run by its messages.
"""

from collections.abc import Iterable, Iterator
from enum import StrEnum

import msgspec

from robrain.lab.soak.operator import OPERATOR, breach_reason
from robrain.lab.soak.soak_run import SoakRun
from robrain.protocol.border.border import Border
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, TaskStatus
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT, TaskEvent
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE, HALT
from robrain.protocol.model.tasks.task import LEASE_S, Task, TaskState
from robrain.protocol.refusals import RefusalCode, Refused
from robrain.recording.invariants.invariant import Invariant
from robrain.recording.invariants.judging import Judging
from robrain.recording.invariants.robot_invariants import MutualWait
from robrain.recording.invariants.task_invariants import TaskAtOne, TaskOnce
from robrain.sim.faults.fault_spec import COORDINATOR, FaultKind

OVERLAP_S = 1.0
"""Two robots may have the same task for this long, plus the delays of slow robots and late messages."""
STRAY_S = LEASE_S + 2.0
"""A robot has stopped work on a task this long after its end, wherever the robot is."""
HALT_S = 2.0
"""A robot stands still this long after it could have received a halt."""
RECEIVED_S = 1.5
"""Two components that have been linked and awake for this long have received each other's messages."""
HEALTHY_S = 60.0
"""A robot whose battery is empty must have been unable to charge within this time."""
PATIENCE_S = 120.0
TASK_S = 40.0
"""Time to settle after the last fault: `PATIENCE_S`, plus `TASK_S` for each task, with half of the robots at work."""
QUIET_S = STRAY_S + 1.0
AS_RECORDED = (TaskAtOne, TaskOnce, MutualWait)
"""Judged here as by `robrain check`. Tasks kept and halts are not judged so. On a full disk tasks wait for longer than
those invariants allow, and a point continues at once after a halt.
"""


class TeamRule(StrEnum):
    """Invariants of a trial."""

    LOST = "lost"
    """An acknowledged task ends as requested: done, cancelled on request, or past its deadline."""
    CHANGED = "changed"
    """A task is carried out as it was submitted: place, priority, deadline, dependencies."""
    TWO_AT_ONCE = "two_at_once"
    """No two robots have the same task for longer than the lease."""
    DONE_TWICE = "done_twice"
    """No task ends twice, is done twice by one agent, or is worked on after its end."""
    NOT_DONE = "not_done"
    """Each task that is reported as done was done."""
    TOO_EARLY = "too_early"
    """No task begins before its predecessors are done, or is done before its earliest time."""
    HALT = "halt"
    """Robots that could have received a halt stand still."""
    STRANDED = "stranded"
    """No robot runs out of energy while it could charge."""
    UNSETTLED = "unsettled"
    """The run settles within a bound after the last fault."""
    FAILED = "failed"
    """No part of the coordinator or host raises an exception."""


class Broken(msgspec.Struct, frozen=True):
    """An invariant that does not hold."""

    invariant: TeamRule | Invariant
    """The latter is judged by messages alone, as of recordings."""
    at_s: float
    what: str
    """In one sentence."""


def broken_in(judging: Judging) -> list[Broken]:
    """Violations that the judges of recordings have found in a run that has ended."""
    return [
        Broken(ruling.invariant, breach.time_s, breach.text)
        for ruling in judging.finish()
        for breach in ruling.breaches
    ]


class Settling:
    """Whether a run has settled and stayed so."""

    def __init__(self) -> None:
        self._quiet_ns: int | None = None

    def stays(self, is_settled: bool, now_ns: int) -> bool:
        """Record the state of now; true once it was settled for `QUIET_S`."""
        if not is_settled:
            self._quiet_ns = None
            return False
        if self._quiet_ns is None:
            self._quiet_ns = now_ns
        return now_ns - self._quiet_ns > to_ns(QUIET_S)


class Judge:
    """Judges one run.

    Args:
        run: the run; `step` is to be called after each of its ticks.

    """

    def __init__(self, run: SoakRun) -> None:
        self.broken: list[Broken] = []
        """Broken invariants, each once for each task or robot."""
        script = run.script
        self._run = run
        self._asked = {order.task.id: order.task for order in script.tasks}
        self._events = Inbox(capacity=65536, border=Border())
        """By no clock: the components' clocks may differ from the run's."""
        self._as_recorded = Judging(judges=AS_RECORDED)
        for topic in (TASK_EVENT, COORDINATOR_STATE, ROBOT_STATE, HALT):
            run.wire.subscribe(self._events, topic)
        self._ends: dict[str, tuple[TaskState, int, int]] = {}
        self._done: dict[str, list[tuple[str, int]]] = {}
        """Agents that have done a task: name and start of the process."""
        self._ends_seen: set[tuple[str, int, str, int]] = set()
        """Ends that were noted: robot, start of its process, task and epoch; without a coordinator epochs are alike."""
        self._reported: set[tuple[TeamRule, str]] = set()
        self._cut_ns = dict.fromkeys(run.robots, 0)
        """Time at which a robot that continues by itself was last disconnected from the coordinator."""
        self._at: dict[str, str] = {}
        self._overlap_s: dict[str, float] = {}
        self._stray_s: dict[tuple[str, str], float] = {}
        late_s = max((fault.late_s[1] for fault in script.faults if fault.late_s is not None), default=0.0)
        slow_s = max((fault.period_s for fault in script.faults if fault.period_s is not None), default=0.0)
        self._slack_s = 2.0 * (late_s + slow_s)
        skews_s = [abs(fault.skew_s) for fault in script.faults if fault.skew_s is not None]
        self._skew_ns = to_ns(sum(skews_s))
        self._halts = _Halts(run, self._slack_s)
        self._unhealthy_ns = dict.fromkeys(run.robots, 0)
        self._drained = {fault.robot for fault in script.faults if fault.kind is FaultKind.DRAIN}
        work_s = TASK_S * len(self._asked) / max(1, len(script.robots) // 2)
        self.settled_by_s = script.faults_end_s + PATIENCE_S + work_s
        """Time by which the run must have settled; faults that wait for events postpone it."""
        self._settling = Settling()

    @property
    def done_count(self) -> int:
        """Tasks that were done."""
        return sum(state is TaskState.DONE for state, _, _ in self._ends.values())

    @property
    def is_over(self) -> bool:
        """Whether the run has settled and stayed so, or should have."""
        now_ns = self._run.now_ns
        return now_ns > to_ns(self.settled_by_s) or self._settling.stays(self._is_settled, now_ns)

    @property
    def _is_settled(self) -> bool:
        run = self._run
        if run.leader is None or not run.faults_are_over or not run.operator.is_content:
            return False
        if any(task not in self._ends for task in run.operator.acknowledged):
            return False
        return not any(run.work(name) for name in run.robots)

    def step(self) -> None:
        """Check the run after a tick."""
        run = self._run
        now_ns = run.now_ns
        for received in self._events.drain():
            message = received.message
            self._as_recorded.handle(message, now_ns)
            if received.topic is TASK_EVENT:
                self._receive(message, now_ns)
            elif received.topic is not HALT:
                self._judge_refusals(message.refused)
            if received.topic is ROBOT_STATE:
                self._check_ends(message.robot, (message.task_before, message.task), now_ns)
        self._check_work(now_ns)
        for name in run.robots:
            host = run.host(name)
            if host is not None:
                facts = host.desk.facts
                self._check_ends(name, (facts.before, facts.task), now_ns)
        for robot in self._halts.disobedient(now_ns):
            self._break(TeamRule.HALT, robot, f"{robot} is not halted, although the team is and it could know")
        self._check_energy(now_ns)

    def finish(self) -> list[Broken]:
        """Judge the end of the run; returns all that did not hold."""
        run = self._run
        if not self._is_settled:
            left = sorted(set(run.operator.acknowledged) - set(self._ends))
            what = f"after {to_seconds(run.now_ns):.0f} s there is left: {', '.join(left) or 'nothing of the tasks'}"
            if not run.operator.is_content:
                what += "; the operator still waits for answers"
            self._break(TeamRule.UNSETTLED, "", what)
        for task_id in run.operator.acknowledged:
            self._judge_end(task_id)
        self.broken += broken_in(self._as_recorded)
        return self.broken

    def raised(self, error: Exception) -> None:
        """A step of a component has raised."""
        what = f"a step raised {type(error).__name__}: {error}"
        self._break(TeamRule.FAILED, what, what)

    # -- tasks ----------------------------------------------------------------------------------------------

    def _receive(self, event: TaskEvent, now_ns: int) -> None:
        task_id, asked = event.task.id, self._asked.get(event.task.id)
        if asked is None:
            return
        if event.task != asked:
            self._break(
                TeamRule.CHANGED, task_id, f"{task_id} is not as it was submitted: {_difference(asked, event.task)}"
            )
        if event.state.ended:
            known = self._ends.get(task_id)
            if known is None:
                self._ends[task_id] = (event.state, event.change, now_ns)
            elif known[1] != event.change:
                self._break(
                    TeamRule.DONE_TWICE, task_id, f"{task_id} has ended as {known[0]}, and again as {event.state}"
                )
        elif task_id in self._ends and event.change > self._ends[task_id][1]:
            self._break(TeamRule.DONE_TWICE, task_id, f"{task_id} has ended and is {event.state} again")

    def _check_work(self, now_ns: int) -> None:
        run = self._run
        robots: dict[str, list[str]] = {}
        for name in run.robots:
            if run.script.consensus and not self._receives_coordinator(name):
                self._cut_ns[name] = now_ns
            task_id = run.work(name)
            if not task_id:
                self._at.pop(name, None)
                continue
            robots.setdefault(task_id, []).append(name)
            if self._at.get(name) != task_id:
                self._at[name] = task_id
                self._judge_begin(task_id, name)
            informed_ns = max(self._ends[task_id][2], self._cut_ns[name]) if task_id in self._ends else now_ns
            if now_ns - informed_ns > to_ns(STRAY_S + self._slack_s):
                what = f"{name} works on {task_id}, which ended {to_seconds(now_ns - self._ends[task_id][2]):.1f} s ago"
                self._break(TeamRule.DONE_TWICE, task_id, what)
        for task_id in [task for task in self._overlap_s if len(robots.get(task, ())) < 2]:
            del self._overlap_s[task_id]
        for task_id, names in robots.items():
            if len(names) > 1:
                self._overlap_s[task_id] = self._overlap_s.get(task_id, 0.0) + run.tick_s
                if self._overlap_s[task_id] > OVERLAP_S + self._slack_s:
                    what = f"{' and '.join(names)} are both at {task_id} for more than {OVERLAP_S + self._slack_s:g} s"
                    self._break(TeamRule.TWO_AT_ONCE, task_id, what)

    def _receives_coordinator(self, robot: str) -> bool:
        """Whether both receive each other's messages."""
        one, other = self._run.processes[robot], self._run.processes[COORDINATOR]
        return one.is_awake and other.is_awake and self._run.is_linked(robot, COORDINATOR)

    def _check_ends(self, robot: str, reported: Iterable[TaskStatus | None], now_ns: int) -> None:
        """Record tasks that a robot has done, by its status and its reports: several tasks may end in one tick."""
        for status in reported:
            if status is not None and status.state is TaskState.DONE and status.id in self._asked:
                self._record_done(robot, status, now_ns)

    def _record_done(self, robot: str, status: TaskStatus, now_ns: int) -> None:
        life = self._run.processes[robot].starts
        end = (robot, life, status.id, status.epoch)
        if end in self._ends_seen:
            return
        self._ends_seen.add(end)
        if (robot, life) in self._done.get(status.id, ()):
            self._break(TeamRule.DONE_TWICE, status.id, f"{robot} has done {status.id} twice")
        self._done.setdefault(status.id, []).append((robot, life))
        if now_ns + self._skew_ns < self._asked[status.id].earliest_ns:
            self._break(TeamRule.TOO_EARLY, status.id, f"{status.id} is done before its earliest time")

    def _judge_begin(self, task_id: str, robot: str) -> None:
        asked = self._asked.get(task_id)
        for name in () if asked is None else asked.after:
            # With consensus, robots know of an end before the coordinator publishes it.
            is_known = self._run.script.consensus and name in self._done
            if not is_known and (name not in self._ends or self._ends[name][0] is not TaskState.DONE):
                self._break(TeamRule.TOO_EARLY, task_id, f"{robot} begins {task_id}, but {name} is not done")

    def _judge_end(self, task_id: str) -> None:
        coordinator = self._run.leader
        record = None if coordinator is None else coordinator.tasks.find(task_id)
        if coordinator is None or (record is not None and task_id not in self._ends):
            return  # reported already, as not settled
        if breach := breach_reason(self._run.operator, self._asked, task_id, record):
            self._break(TeamRule.LOST, task_id, breach)
        elif self._ends[task_id][0] is TaskState.DONE and task_id not in self._done:
            self._break(TeamRule.NOT_DONE, task_id, f"{task_id} counts as done, and no robot has done it")

    # -- robots ---------------------------------------------------------------------------------------------

    def _check_energy(self, now_ns: int) -> None:
        run = self._run
        is_halted = run.operator.halt is not None
        for name, robot in run.robots.items():
            host = run.host(name)
            may_drain = is_halted or host is None or not run.processes[name].is_awake or host.manager.halted
            if may_drain or name in self._drained:
                self._unhealthy_ns[name] = now_ns
            elif robot.energy_j <= 0.0 and now_ns - self._unhealthy_ns[name] > to_ns(HEALTHY_S):
                self._break(TeamRule.STRANDED, name, f"{name} has run out of energy")

    def _judge_refusals(self, refused: Refused) -> None:
        for one in () if refused is msgspec.UNSET else refused:
            if one.code == RefusalCode.FAILED:
                self._break(TeamRule.FAILED, f"{one.topic} {one.key}", one.words)

    def _break(self, invariant: TeamRule, subject: str, what: str) -> None:
        if (invariant, subject) not in self._reported:
            self._reported.add((invariant, subject))
            self.broken.append(Broken(invariant, round(to_seconds(self._run.now_ns), 1), what))


class _Halts:
    """Components that could know of the halt that is in force.

    A component knows of a halt if it is linked with the operator while the operator publishes it. A link with a
    component that knows is enough: robots report to the coordinator, the coordinator to robots. A component that dies
    forgets it.
    """

    def __init__(self, run: SoakRun, slack_s: float) -> None:
        self._run = run
        self._slack_ns = to_ns(HALT_S + slack_s)
        self._halt: object = None
        self._informed_ns: dict[str, int] = {}
        self._linked_ns: dict[str, int] = {}
        self._lives: dict[str, object] = {}
        self._is_lossy = any(fault.share is not None for fault in run.script.faults)

    def disobedient(self, now_ns: int) -> Iterator[str]:
        """Robots that move although they could know of the halt."""
        run, halt = self._run, self._run.operator.halt
        if halt is None:
            self._halt = None
            self._informed_ns.clear()
            self._linked_ns.clear()
            return
        if halt is not self._halt:
            self._halt = halt
            for name in run.processes:
                if self._receives(name) and run.is_linked(OPERATOR, name) and not self._is_lossy:
                    self._informed_ns[name] = now_ns
        self._forget()
        self._spread(now_ns)
        for name, robot in run.robots.items():
            since_ns = self._informed_ns.get(name)
            host = run.host(name)
            is_free = host is not None and (robot.forward_m > 0 or not host.manager.halted)
            if since_ns is not None and now_ns - since_ns > self._slack_ns and is_free and self._receives(name):
                yield name

    def _forget(self) -> None:
        for name, process in self._run.processes.items():
            if process.component is None or process.component is not self._lives.get(name, process.component):
                self._informed_ns.pop(name, None)
                self._linked_ns.pop(name, None)
            self._lives[name] = process.component  # one that was killed may be there again within a tick

    def _spread(self, now_ns: int) -> None:
        run = self._run
        for name in run.robots:
            is_linked = run.is_linked(name, COORDINATOR)
            if not (self._receives(name) and self._receives(COORDINATOR) and is_linked):
                self._linked_ns.pop(name, None)
                continue
            since_ns = self._linked_ns.setdefault(name, now_ns)
            if now_ns - since_ns <= to_ns(RECEIVED_S) + self._slack_ns or self._is_lossy:
                continue
            for one, other in ((name, COORDINATOR), (COORDINATOR, name)):
                if one in self._informed_ns and now_ns - self._informed_ns[one] > to_ns(RECEIVED_S):
                    self._informed_ns.setdefault(other, now_ns)

    def _receives(self, name: str) -> bool:
        return self._run.processes[name].is_awake


def _difference(asked: Task, published: Task) -> str:
    before, after = msgspec.to_builtins(asked), msgspec.to_builtins(published)
    names = sorted(name for name in before.keys() | after.keys() if before.get(name) != after.get(name))
    return ", ".join(f"{name} {before.get(name)} is {after.get(name)}" for name in names)
