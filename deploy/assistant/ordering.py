"""Tools of an assistant that change something: each is rehearsed first, and carried out only after a confirmation."""

from collections.abc import Callable
from typing import NamedTuple

import msgspec

from robrain.client.team import Team
from robrain.deploy.assistant.arguments import (
    CallPlugin,
    CallVerdict,
    CancelTask,
    HaltRobots,
    SubmitTask,
    ToolAnswer,
    answer,
)
from robrain.deploy.assistant.policy import OPEN_TASKS_MAX, Ban, CallRefused, call_refusal, cancel_refusal
from robrain.deploy.assistant.team_reader import OPEN, TeamReader, task_line
from robrain.deploy.tasks.task_files import dry_run_lines
from robrain.protocol.errors import NobodyThere
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

        return Rehearsal(
            [f"task {task_id}", *dry_run_lines(found)], {"task": task_id, "robots": found.robots}, carry_out
        )

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
        return Rehearsal(words, {"task": asked.task, "state": record.state, "robot": record.robot}, carry_out)

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
    except NobodyThere as error:  # a halt of the team was sent all the same
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
