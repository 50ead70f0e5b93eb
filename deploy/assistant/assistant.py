"""One assistant at one team: checks, rehearses, confirms, carries out and logs every call of a tool."""

import hmac
import itertools
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any, Generic, NamedTuple, TypeVar, cast

import msgspec

from robrain.client.team import Team
from robrain.deploy.assistant.arguments import (
    Arguments,
    CallPlugin,
    CallVerdict,
    CancelTask,
    HaltRobots,
    ListTasks,
    NewTask,
    OfRobot,
    OfTask,
    SubmitTask,
    ToolAnswer,
    answer,
    arguments_of,
    halt_arguments,
    order_text,
)
from robrain.deploy.assistant.audit_log import AuditLog, AuditRecord
from robrain.deploy.assistant.policy import (
    OPEN_TASKS_MAX,
    AuditError,
    Ban,
    CallRefused,
    Order,
    call_refusal,
    cancel_refusal,
    order_refusal,
)
from robrain.deploy.assistant.team_reader import OPEN, TeamReader, foreseen, task_line
from robrain.deploy.tasks.task_files import dry_run_lines
from robrain.protocol.access.member import Member
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere, RobrainError
from robrain.protocol.messages.robots.plugin_messages import FunctionInfo, PluginInfo
from robrain.protocol.messages.tasks.task_messages import TaskFilter
from robrain.protocol.model.tasks.task import BadParameters
from robrain.protocol.schema.announced_parameters import check_announced

CALL_TIMEOUT_S = 10.0


class Rehearsal(NamedTuple):
    """The expected effect of an order, and the function that carries it out."""

    words: list[str]
    values: dict[str, object]
    carry_out: Callable[[], ToolAnswer]
    """Once, after the confirmation. The team checks again everything that has changed since."""


class Ordering:
    """Rehearses orders, and carries them out.

    Args:
        team: a connection, used by one thread at a time.
        reader: for the coordinator's dry runs.
        new_id: a suffix for the id of a task, which no other task has.

    """

    def __init__(self, team: Team, reader: TeamReader, new_id: Callable[[], str]) -> None:
        self._team = team
        self._reader = reader
        self._new_id = new_id

    def submit_task(self, asked: SubmitTask) -> Rehearsal:
        """Submit a task to the team, which decides which robot does it."""
        self._check_open_tasks()
        task_id = f"{asked.kind}-{self._new_id()}"
        found = self._reader.foresee(asked, task_id)
        if found.refused:
            raise CallRefused(Ban.TEAM, found.refused)

        def carry_out() -> ToolAnswer:
            self._check_open_tasks()  # others may have been confirmed since the rehearsal
            record = self._team.submit(asked.kind, id=task_id, parameters=asked.fields)
            return answer(
                CallVerdict.DONE, [f"submitted {task_line(record)}"], {"task": task_id, "state": record.state}
            )

        return Rehearsal([f"task {task_id}", *dry_run_lines(found)], {"task": task_id, **foreseen(found)}, carry_out)

    def cancel_task(self, asked: CancelTask) -> Rehearsal:
        """Cancel a task that this assistant has submitted; its robot stops it."""
        explained = self._team.why(asked.task)
        record = explained.record
        if (ban := cancel_refusal(record, self._team.by)) is not None:
            whose = f"{asked.task} is {record.state}, by {record.by or 'nobody'}"
            raise CallRefused(ban, whose)
        stops = f"{record.robot} would stop it" if record.robot else "no robot has begun it"

        def carry_out() -> ToolAnswer:
            ended = self._team.cancel(asked.task, asked.reason)
            return answer(
                CallVerdict.DONE, [f"cancelled {task_line(ended)}"], {"task": asked.task, "state": ended.state}
            )

        words = [f"{asked.task} would end unfinished: {explained.now}", stops]
        waiting = [one.task.id for one in self._team.list(TaskFilter(states=OPEN)) if asked.task in one.task.after]
        words += [f"{name} waits for it, and would never be done" for name in waiting]
        values: dict[str, object] = {"task": asked.task, "state": record.state, "robot": record.robot}
        return Rehearsal(words, {**values, "waiting": waiting}, carry_out)

    def _check_open_tasks(self) -> None:
        if len(self._team.list(TaskFilter(states=OPEN, by=self._team.by))) >= OPEN_TASKS_MAX:
            raise CallRefused(Ban.TOO_MANY_TASKS)

    def call_plugin(self, asked: CallPlugin) -> Rehearsal:
        """Call a function of a robot's plugin, if its manifest opens it to the outside and it causes no motion."""
        plugins = self._team.plugins(asked.robot)
        where = f"{asked.robot} {asked.plugin}.{asked.function}"
        if (ban := call_refusal(asked.plugin, asked.function, plugins)) is not None:
            raise CallRefused(ban, where)
        plugin = next(one for one in plugins if one.name == asked.plugin)
        function = _fitting(plugin, asked)

        def carry_out() -> ToolAnswer:
            named = asked.arguments
            result = self._team.call(asked.robot, asked.plugin, asked.function, named=named, timeout_s=CALL_TIMEOUT_S)
            return answer(CallVerdict.DONE, [f"{where} returned {_json(result)}"], {"result": result})

        doc = function.doc.partition("\n")[0]
        words = [
            f"{where}{function.signature} would be called with {_json(asked.arguments)}",
            f"it says of itself: {doc}",
        ]
        if plugin.state != "active":
            words.append(f"the plugin is {plugin.state}, so the call may be refused: {plugin.why}")
        return Rehearsal(words, {"plugin_state": plugin.state, "signature": function.signature}, carry_out)


def halt(team: Team, asked: HaltRobots) -> ToolAnswer:
    """Stop all robots at once, or one of them. Needs no confirmation. Only a person ends a halt.

    Args:
        team: a connection without other use meanwhile.
        asked: robots to halt.

    """
    try:
        report = team.halt(asked.robot or None, reason=asked.reason)
    except NobodyThere as error:  # a halt of the team was sent nevertheless
        return answer(CallVerdict.FAILED, [str(error)])
    lines = [f"{name}: halted" for name in report.confirmed]
    lines += [f"{name}: NOT halted: {reason}" for name, reason in report.unconfirmed.items()]
    lines.append("a person ends this with `robrain resume`")
    verdict = CallVerdict.FAILED if report.unconfirmed else CallVerdict.DONE
    return answer(verdict, lines, {"confirmed": report.confirmed, "unconfirmed": report.unconfirmed})


def _fitting(plugin: PluginInfo, asked: CallPlugin) -> FunctionInfo:
    """The signature that accepts the arguments (Refused if none does)."""
    functions = [one for one in plugin.functions if one.name == asked.function]
    mismatch = ""
    for one in functions:
        try:
            check_announced(asked.function, asked.arguments, [one.parameters])
        except BadParameters as error:
            mismatch = mismatch or f"{asked.function}{one.signature}: {error.field}: {error.why or 'is missing'}"
        else:
            return one
    raise CallRefused(Ban.BAD_ARGUMENTS, mismatch)


def _json(value: object) -> str:
    return msgspec.json.encode(value, enc_hook=str).decode()


LIFE_S = 120.0
"""Chosen: long enough for a person to read or listen to the expected effect, too short for the team to change."""
CAPACITY = 32
"""Most orders that wait; the oldest is dropped for a new one."""


class _Waiting(NamedTuple):
    who: str
    order: bytes
    plan: Any
    until_s: float


class Confirmations:
    """Orders that were rehearsed and wait to be confirmed.

    Args:
        now_s: a clock that never goes back, seconds.
        new_token: makes a token that cannot be guessed.

    """

    def __init__(self, now_s: Callable[[], float], new_token: Callable[[], str]) -> None:
        self.dropped = 0
        """Orders that were dropped for newer ones."""
        self._now_s = now_s
        self._new_token = new_token
        self._waiting: OrderedDict[str, _Waiting] = OrderedDict()

    def __len__(self) -> int:
        return len(self._waiting)

    def keep(self, who: str, order: bytes, plan: Any) -> str:
        """Keep an order until it is confirmed.

        Args:
            who: the client that gives it; another cannot confirm it.
            order: the tool and all of its arguments, in one canonical form.
            plan: action to carry out after the confirmation.

        Returns:
            The token.

        """
        now_s = self._now_s()
        for token in [token for token, one in self._waiting.items() if one.until_s <= now_s]:
            del self._waiting[token]
        while len(self._waiting) >= CAPACITY:
            self._waiting.popitem(last=False)
            self.dropped += 1
        token = self._new_token()
        self._waiting[token] = _Waiting(who, order, plan, now_s + LIFE_S)
        return token

    def redeem(self, token: str, who: str, order: bytes) -> Any:
        """The plan of an order that is confirmed, or why it is not. The token is void afterwards in any case."""
        one = self._waiting.pop(token, None)
        if one is None:
            return Ban.NO_TOKEN
        if one.until_s <= self._now_s():
            return Ban.EXPIRED
        if one.who != who or not hmac.compare_digest(one.order, order):
            return Ban.ANOTHER_ORDER
        return one.plan


A = TypeVar("A", bound=Arguments)
NOT_SURE = frozenset((ErrorCode.TIMEOUT, ErrorCode.FAILED, ErrorCode.UNLOADED))
"""Errors after which an order may nevertheless have been carried out."""


class Tool(NamedTuple, Generic[A]):
    """One tool."""

    name: str
    doc: str
    arguments: type[A]
    read: Callable[[A], ToolAnswer] | None = None
    """Of a tool that changes nothing."""
    rehearse: Callable[[A], Rehearsal] | None = None
    """Of an order that is confirmed before it is carried out. Of neither: the halt."""


class ToolCall(NamedTuple):
    """A call as it came."""

    client: str
    """Name and version that the MCP client gives of itself."""
    tool: str
    arguments: object


class Assistant:
    """Answers calls of tools. All but halts are answered one at a time.

    Args:
        team: a connection to the team, for all but halts.
        halting: a separate session, so that a halt does not wait.
        member: member of the certificate; None in a team that is not secured.
        log: of all calls.
        confirmations: orders that wait for their confirmation.
        new_id: see `Ordering`.
        now: the time of day, for the log.
        elapsed_s: a clock that never goes back, seconds.
        warn: prints a line for the person at this process.

    """

    def __init__(
        self,
        team: Team,
        halting: Team,
        member: Member | None,
        log: AuditLog,
        confirmations: Confirmations,
        *,
        new_id: Callable[[], str],
        now: Callable[[], datetime],
        elapsed_s: Callable[[], float],
        warn: Callable[[str], None],
    ) -> None:
        self._halting = halting
        self._member = member
        self._log = log
        self._confirmations = confirmations
        self._now = now
        self._elapsed_s = elapsed_s
        self._warn = warn
        self._by = team.by
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._log_lock = threading.Lock()
        self.tools: Mapping[str, Tool[Any]] = {tool.name: tool for tool in _tools(team, new_id)}

    def may(self, tool: str) -> bool:
        """Whether the certificate allows a tool."""
        return tool not in tuple(Order) or order_refusal(Order(tool), self._member) is None

    def answer(self, call: ToolCall) -> ToolAnswer:
        """Answer a call, and log it."""
        began_s = self._elapsed_s()
        number = next(self._numbers)
        try:
            found = self._answer(call, number)
        except RobrainError as error:
            found = _refused(error)
        except BaseException as error:  # a bug, or the end of the process: logged as well
            self._log_end(call, number, answer(CallVerdict.FAILED, [f"{type(error).__name__}: {error}"]), began_s)
            raise
        self._log_end(call, number, found, began_s)
        return found

    def _log_end(self, call: ToolCall, number: int, found: ToolAnswer, began_s: float) -> None:
        try:
            self._write(call, number, found, 1000.0 * (self._elapsed_s() - began_s))
        except AuditError as error:  # the action is done; `_carry_out` had logged it before
            self._warn(f"assistant: {error}")

    def _answer(self, call: ToolCall, number: int) -> ToolAnswer:
        tool = self.tools.get(call.tool)
        if tool is None:
            raise CallRefused(Ban.UNKNOWN_TOOL)
        if not self.may(tool.name):
            raise CallRefused(Ban.ROLE, f"it is that of {self._member}")
        if tool.arguments is HaltRobots:  # without a lock, and with any arguments
            return halt(self._halting, halt_arguments(call.arguments))
        asked = arguments_of(call.arguments, tool.arguments)
        with self._lock:
            if tool.read is not None:
                return tool.read(asked)
            assert tool.rehearse is not None
            order = order_text(tool.name, asked)
            if asked.confirm:
                return self._carry_out(call, number, asked.confirm, order)
            return self._rehearsed(tool.rehearse(asked), call.client, order)

    def _carry_out(self, call: ToolCall, number: int, token: str, order: bytes) -> ToolAnswer:
        found = self._confirmations.redeem(token, call.client, order)
        if isinstance(found, Ban):
            raise CallRefused(found)
        try:
            self._write(call, number, ToolAnswer(CallVerdict.BEGUN, "", {}), 0.0)
        except AuditError as error:
            raise CallRefused(Ban.NOT_LOGGED, str(error)) from error
        try:
            return cast(Rehearsal, found).carry_out()
        except (NobodyThere, CallError) as error:
            if isinstance(error, CallError) and error.code not in NOT_SURE:
                raise
            return answer(CallVerdict.FAILED, [f"failed, and it may have been done: {error}"])

    def _rehearsed(self, found: Rehearsal, client: str, order: bytes) -> ToolAnswer:
        token = self._confirmations.keep(client, order, found)
        lines = [
            f"nothing has been done yet; to execute the order, repeat the call within {LIFE_S:.0f} s, and add",
            f"confirm={token}",
            "this would happen:",
            *found.words,
        ]
        return answer(CallVerdict.REHEARSED, lines, {**found.values, "confirm": token, "valid_s": LIFE_S})

    def _write(self, call: ToolCall, number: int, found: ToolAnswer, duration_ms: float) -> None:
        try:
            arguments = msgspec.json.encode(call.arguments, enc_hook=repr).decode()
        except (TypeError, ValueError, RecursionError):
            arguments = "not JSON"
        record = AuditRecord(
            stamp=self._now().astimezone(UTC).isoformat(timespec="milliseconds"),
            call=number,
            by=self._by,
            client=call.client,
            tool=call.tool,
            arguments=arguments,
            verdict=found.verdict,
            code=found.code,
            words=found.words,
            duration_ms=round(duration_ms, 1),
        )
        with self._log_lock:
            self._log.write(record)


def _refused(error: RobrainError) -> ToolAnswer:
    if not isinstance(error, CallRefused):
        error = CallRefused(Ban.NOBODY if isinstance(error, NobodyThere) else Ban.TEAM, str(error))
    return answer(CallVerdict.REFUSED, [str(error)], code=str(error.ban))


def _tools(team: Team, new_id: Callable[[], str]) -> list[Tool[Any]]:
    reader = TeamReader(team)
    order = Ordering(team, reader, new_id)

    def reads(run: Callable[[A], ToolAnswer], arguments: type[A]) -> Tool[A]:
        return Tool(run.__name__, run.__doc__ or "", arguments, read=run)

    def orders(name: Order, run: Callable[[A], Rehearsal], arguments: type[A]) -> Tool[A]:
        return Tool(name, run.__doc__ or "", arguments, rehearse=run)

    return [
        reads(reader.list_robots, Arguments),
        reads(reader.robot_state, OfRobot),
        reads(reader.team_state, Arguments),
        reads(reader.list_plugins, OfRobot),
        reads(reader.list_kinds, Arguments),
        reads(reader.list_tasks, ListTasks),
        reads(reader.explain_task, OfTask),
        reads(reader.show_map, Arguments),
        reads(reader.dry_run, NewTask),
        orders(Order.SUBMIT, order.submit_task, SubmitTask),
        orders(Order.CANCEL, order.cancel_task, CancelTask),
        orders(Order.CALL, order.call_plugin, CallPlugin),
        Tool(Order.HALT, "Stop all robots at once, or one. Only a person ends a halt.", HaltRobots),
    ]
