"""`robrain shell ROBOT`: the text form from anywhere on the team's wire, with completion, history and help."""

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from prompt_toolkit import PromptSession
from prompt_toolkit.auto_suggest import AutoSuggestFromHistory
from prompt_toolkit.completion import CompleteEvent, Completer, Completion
from prompt_toolkit.document import Document
from prompt_toolkit.history import FileHistory, History, InMemoryHistory

from robrain.agent.host.command_door import Question, answer_question, parse_command, usage, visible_to_command
from robrain.client.team import Team
from robrain.deploy.command_line.output import print_result
from robrain.deploy.command_line.terminal import print_line
from robrain.protocol.errors import CallError, RobrainError
from robrain.protocol.messages.robots.plugin_messages import FunctionInfo, PluginInfo
from robrain.protocol.state_folder import state_folder

ENDS = ("exit", "quit")
VERBS = ("call", "help", "list", "exit")


class RemoteCommands:
    """The shell's connection to one robot.

    Args:
        team: the robot's team.
        robot: its name.

    """

    def __init__(self, team: Team, robot: str) -> None:
        self._team = team
        self._robot = robot
        self.plugins: list[PluginInfo] = []
        """Plugins that can be called from outside, as of the last refresh."""

    def refresh(self) -> None:
        """Ask the robot for its plugins.

        Raises:
            RobrainError: it does not answer.

        """
        self.plugins = visible_to_command(self._team.plugins(self._robot))

    def answer(self, text: str) -> str:
        """Execute one command; calls are executed by the robot, `list` and `help` answered from its plugins.

        Raises:
            RobrainError: the command, or its call, is wrong or refused; or the robot does not answer.

        """
        command = parse_command(text)
        if isinstance(command, Question):
            self.refresh()
            return answer_question(command, self.plugins)
        return self._team.command(self._robot, text)


class RobotCompleter(Completer):
    """Completes commands, names of plugins and functions, and names of parameters."""

    def __init__(self, commands: RemoteCommands) -> None:
        self._commands = commands

    def get_completions(self, document: Document, complete_event: CompleteEvent) -> Iterable[Completion]:
        """Completions of the input."""
        for text, begun, meta in completions(document.text_before_cursor, self._commands.plugins):
            yield Completion(text, start_position=-len(begun), display_meta=meta)


def completions(text: str, plugins: list[PluginInfo]) -> list[tuple[str, str, str]]:
    """Completions of a text: each with the part that is typed already, and a description.

    >>> completions("ca", [])
    [('call ', 'ca', '')]
    """
    head, bracket, arguments = text.partition("(")
    words = head.split()
    begun = "" if not words or head[-1].isspace() else words.pop()
    candidates: list[tuple[str, str]] = []
    if bracket:
        function = _function(plugins, [*words, begun])
        begun = arguments.rpartition(",")[2].lstrip()
        if function is not None:
            candidates = [(f"{name}=", meta) for name, meta in parameters_of(function) if f"{name}=" not in arguments]
    elif not words:
        candidates = [(verb if verb in ("list", "exit") else f"{verb} ", "") for verb in VERBS]
    elif words in (["call"], ["help"]):
        end = " " if words == ["call"] else ""
        candidates = [(plugin.name + end, plugin.doc) for plugin in plugins if plugin.functions or not end]
    elif len(words) == 2 and words[0] == "call":
        found = [plugin for plugin in plugins if plugin.name == words[1]]
        candidates = [(f"{one.name}(", usage(one)) for plugin in found for one in plugin.functions]
    return [(text, begun, meta) for text, meta in dict.fromkeys(candidates) if text.startswith(begun)]


def parameters_of(function: FunctionInfo) -> list[tuple[str, str]]:
    """Names of a function's parameters, each with its type in the JSON Schema."""
    schema: dict[str, Any] = function.parameters
    if "$ref" in schema:
        schema = schema.get("$defs", {}).get(str(schema["$ref"]).rpartition("/")[2], {})
    return [(name, str(one.get("type", ""))) for name, one in schema.get("properties", {}).items()]


def run_shell(team: Team, robot: str, *, interactive: bool) -> int:
    """Talk to a robot in the text form until the input ends.

    Args:
        team: the robot's team.
        robot: its name.
        interactive: whether a person types at a terminal; if not, commands are the lines of stdin.

    Returns:
        The exit status: 1 if a line of stdin failed.

    Raises:
        RobrainError: the robot does not answer at all.

    """
    commands = RemoteCommands(team, robot)
    commands.refresh()
    return _talk(commands, robot) if interactive else _read(commands)


def history_path() -> Path:
    """Path of the command history: in the user's state folder."""
    return state_folder() / "shell_history"


def _talk(commands: RemoteCommands, robot: str) -> int:
    session: PromptSession[str] = PromptSession(
        f"{robot}> ",
        completer=RobotCompleter(commands),
        auto_suggest=AutoSuggestFromHistory(),
        history=_history(),
        complete_while_typing=True,
    )
    print_result(f"{robot}: {len(commands.plugins)} plugins; `help` tells what can be called, `exit` or Ctrl-D ends")
    while True:
        try:
            line = session.prompt().strip()
        except KeyboardInterrupt:
            continue
        except EOFError:
            return 0
        if line in ENDS:
            return 0
        if line:
            _execute(commands, line)


def _read(commands: RemoteCommands) -> int:
    failed = False
    for line in sys.stdin.buffer:
        text = line.decode(errors="backslashreplace").strip()
        if text in ENDS:
            break
        if text:
            failed = not _execute(commands, text) or failed
    return 1 if failed else 0


def _execute(commands: RemoteCommands, line: str) -> bool:
    try:
        answer = commands.answer(line)
    except CallError as error:
        print_result(f"error {error.code}: {error.message}")
        return False
    except RobrainError as error:
        print_result(f"error: {error}")
        return False
    if answer:
        print_line(answer)
    return True


def _history() -> History:
    try:
        path = history_path()
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a", encoding="utf-8"):
            return FileHistory(path)
    except (OSError, RobrainError):
        return InMemoryHistory()  # the shell also works without a history file


def _function(plugins: list[PluginInfo], words: list[str]) -> FunctionInfo | None:
    if len(words) != 3 or words[0] != "call":
        return None
    name = words[2].rpartition(".")[2].partition("-")[0]  # a signature name is accepted too
    functions = (one for plugin in plugins if plugin.name == words[1] for one in plugin.functions)
    return next((one for one in functions if one.name == name), None)
