"""`robrain call ROBOT PLUGIN FUNCTION ARGUMENTS`: one call of a robot's plugin, and its result or its action's end."""

from typing import Any

import msgspec

from robrain.agent.host.command_door import TextCall, parse_call
from robrain.agent.text_form import parse_argument, parse_value, print_value
from robrain.client.team import Team
from robrain.deploy.command_line.output import print_json
from robrain.deploy.command_line.terminal import print_line
from robrain.deploy.errors import UsageError
from robrain.protocol.keys import check_name
from robrain.protocol.messages.robots.action_messages import Outcome

EXIT_NOT_DONE = 1


def call_command(
    connect: str | None, team: str, robot: str, plugin: str, function: str, words: list[str], *, as_json: bool
) -> int:
    """Call an external function of a robot's plugin and print its result; wait for the end of a long action.

    Args:
        connect: endpoint of the team; None uses $ROBRAIN_CONNECT, else this machine's hub.
        team: its name.
        robot: name of the robot.
        plugin: name of the plugin.
        function: its external name, or the text form `drive(1.0)` including the arguments; if empty, the functions
            of the plugin are printed.
        words: the arguments, each `VALUE` or `NAME=VALUE` as in the text form; or a single JSON array or object.
        as_json: print the result, or the end of the action, as JSON.

    Returns:
        Exit status: 1 if a long action has ended otherwise than done.

    Raises:
        CallError: the robot refuses the call, or the plugin fails.
        NobodyThere: the robot is not there; the text lists the robots that are.
        UsageError: the arguments cannot be read.

    """
    for what, name in (("team", team), ("robot", robot), ("plugin", plugin)):
        check_name(what, name)
    if not function:
        _print_functions(connect, team, robot, plugin)
        return 0
    given = _json_of(words[0]) if len(words) == 1 and words[0].lstrip()[:1] in ("[", "{") else None
    text = "" if given is not None else _text_of(plugin, function, words)
    if text and as_json:
        call = parse_call(text)
        function, given = call.function, _plain_values(call)
    with Team.connect(connect, team=team) as client, client.action_ends(robot, plugin) as ends:
        if given is None:
            result: Any = client.command(robot, text)
            text = result
        else:
            check_name("function", function)
            named = given if isinstance(given, dict) else None
            result = client.call(robot, plugin, function, *([] if named is not None else given), named=named)
            text = "" if result is None else print_value(result)
        if not isinstance(result, str) or not _starts_action(client, robot, plugin, function):
            if as_json:
                print_json(result)
            elif text:
                print_line(text)
            return 0
        if not as_json:
            print_line(text)
        end = ends.end_of(result)
    if as_json:
        print_json(end)
    else:
        print_line(end.words if end.result is None else f"{end.words}: {print_value(end.result)}")
    return 0 if end.outcome is Outcome.DONE else EXIT_NOT_DONE


def _print_functions(connect: str | None, team: str, robot: str, plugin: str) -> None:
    with Team.connect(connect, team=team) as client:
        plugins = {info.name: info for info in client.plugins(robot)}
    if plugin not in plugins:
        raise UsageError(f"{robot} has no plugin {plugin}; there are: {', '.join(plugins)}")
    for info in plugins[plugin].functions:
        print_line(f"{info.name}{info.signature}  {info.doc.partition(chr(10))[0]}".rstrip())
    if not plugins[plugin].functions:
        print_line(f"{plugin} has no functions that can be called from outside")


def _starts_action(client: Team, robot: str, plugin: str, function: str) -> bool:
    known = (info for one in client.plugins(robot) if one.name == plugin for info in one.functions)
    return any(info.starts_action for info in known if info.name == function.partition("(")[0])


def _json_of(word: str) -> list[Any] | dict[str, Any]:
    try:
        return msgspec.json.decode(word, type=list[Any] | dict[str, Any])
    except (msgspec.DecodeError, RecursionError) as error:
        raise UsageError(f"arguments {word}: expected a JSON array or object: {error}") from error


def _text_of(plugin: str, function: str, words: list[str]) -> str:
    """The text form of a call; each word of the command line is one argument (UsageError if one holds several)."""
    if "(" in function:
        return " ".join([f"call {plugin} {function}", *words])
    text = f"call {plugin} {function}({', '.join(words)})"
    wanted = [word.strip() for word in words]
    if parse_call(text) != TextCall(plugin, function, wanted):
        raise UsageError(f"{text}: expected one argument per word; put text with commas or brackets in double quotes")
    return text


def _plain_values(call: TextCall) -> list[Any] | dict[str, Any]:
    """The arguments as JSON values, by position or by name; a word that is not JSON is text."""
    named: dict[str, Any] = {}
    unnamed: list[Any] = []
    for word in call.arguments:
        name, text = parse_argument(word)
        value = parse_value(text, Any)
        if name is None:
            unnamed.append(value)
        else:
            named[name] = value
    if named and unnamed:
        raise UsageError("--json: expected either all arguments as NAME=VALUE, or none")
    return named or unnamed
