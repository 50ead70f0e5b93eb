"""Changes of a fork from the words of the command line; each mistake is one sentence."""

import json
import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import typer

from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.deploy.command_line.options import point
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.table_files import read_planning
from robrain.deploy.tasks.task_commands import add, asked_tasks
from robrain.lab.fork.changes import AddFault, AddTask, Change, SetPolicy, Without
from robrain.sim.faults.fault_spec import FaultKind, FaultSpec

_MOMENT = re.compile(r"(?:(\d{1,6})m)?(?:(\d{1,9}(?:\.\d{1,9})?)s?)?")
_WRONG_USAGE: type[Exception] = typer.BadParameter.__mro__[2]
"""Base of typer's exceptions for a wrong command line; typer does not export it."""


def moment_s(words: str) -> float:
    """Seconds of `412s`, `412.5`, `6m52s` or `6m` (UsageError for another form).

    >>> moment_s("6m52s")
    412.0
    """
    found = _MOMENT.fullmatch(words)
    if not words or found is None:
        raise UsageError(f"--at {words}: expected a time of the run, such as 412s or 6m52s")
    minutes, seconds = found.groups()
    return 60.0 * float(minutes or 0) + float(seconds or 0)


def changes_of(
    at_s: float,
    *,
    without: Sequence[str],
    tasks: Sequence[str],
    policy: Sequence[str],
    faults: Sequence[str],
    in_force: PlanningPolicy,
) -> list[Change]:
    """The changes that options ask for.

    Args:
        at_s: their moment.
        without: names of robots.
        tasks: each as the arguments of `robrain task add`.
        policy: files, or KEY=VALUE.
        faults: each ROBOT:KIND, ROBOT:KIND:SECONDS, or ROBOT:carried_off:X,Y.
        in_force: the policy to change.

    Raises:
        UsageError, BadTask: naming the option.

    """
    changes: list[Change] = [AddFault(fault=_fault(words, at_s)) for words in faults]
    changes += [Without(at_s=at_s, robot=robot) for robot in without]
    if policy:
        changes.append(SetPolicy(at_s=at_s, planning=_policy(policy, in_force)))
    for words in tasks:
        changes += _tasks(words, at_s)
    return changes


def _tasks(words: str, at_s: float) -> list[Change]:
    found: list[Change] = []

    def add_tasks(**given: Any) -> None:
        for option in ("connect", "as_json", "team", "dry_run"):
            if given.pop(option) not in (None, False, "default"):
                name = option.removeprefix("as_").replace("_", "-")
                raise UsageError(f"--task {words}: a task of a fork has no --{name}")
        found.extend(AddTask(at_s=at_s, kind=kind, fields=fields) for kind, fields in asked_tasks(**given))

    command = typer.main.get_command_from_info(
        typer.models.CommandInfo(name="task", callback=add, add_help_option=False),
        pretty_exceptions_short=True,
        rich_markup_mode=None,
    )
    try:
        given = command.make_context("task", shlex.split(words)).params
        add_tasks(**given)
    except ValueError as error:  # a quote that is not closed
        raise UsageError(f"--task {words}: {error}") from error
    except _WRONG_USAGE as error:
        text = error.format_message() if hasattr(error, "format_message") else str(error)
        raise UsageError(f"--task {words}: {text.rstrip('.')}; use the options of `robrain task add`") from error
    return found


def _policy(words: Sequence[str], in_force: PlanningPolicy) -> PlanningPolicy:
    policy = in_force
    for word in words:
        key, equals, text = word.partition("=")
        if not equals:
            policy = read_planning(Path(word), "--policy")
            continue
        try:
            value = json.loads(text)
        except (ValueError, RecursionError):
            value = text
        try:
            policy = msgspec.convert({**msgspec.to_builtins(policy), key: value}, PlanningPolicy)
        except msgspec.ValidationError as error:
            raise UsageError(f"--policy {word}: {str(error).partition(' - at `$')[0]}") from error
    return policy


def _fault(words: str, at_s: float) -> FaultSpec:
    robot, _, rest = words.partition(":")
    kind_word, _, more = rest.partition(":")
    try:
        kind = FaultKind(kind_word)
    except ValueError as error:
        kinds = ", ".join(FaultKind)
        raise UsageError(f"--fault {words}: expected ROBOT:KIND or ROBOT:KIND:SECONDS; kinds are {kinds}") from error
    place_m, until_s = None, None
    if kind is FaultKind.CARRIED_OFF:
        x_m, y_m = point(f"--fault {words}:", more)
        place_m = (x_m, y_m)
    elif more:
        try:
            until_s = at_s + float(more.removesuffix("s"))
        except ValueError as error:
            raise UsageError(f"--fault {words}: expected a number of seconds behind the kind, got {more}") from error
    try:
        return FaultSpec(robot=robot, kind=kind, at_s=at_s, until_s=until_s, place_m=place_m)
    except ValueError as error:
        raise UsageError(f"--fault {words}: {error}") from error
