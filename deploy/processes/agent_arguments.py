"""The arguments of `robrain agent`, read without the library that reads those of the other commands."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple


class AgentWords(NamedTuple):
    """Arguments of `agent_command`."""

    robot: Path
    connect: str | None
    team: str | None
    votes: Path | None = None


def agent_arguments(words: Sequence[str]) -> AgentWords | None:
    """The arguments of a plain `agent ROBOT [--connect ENDPOINT] [--team NAME] [--votes FOLDER]`.

    None for all other arguments, including mistakes and `--help`: Typer reads them, and loads pydantic for that. A
    robot's process would keep these 10 MB while it runs, and start a quarter of a second later.

    >>> agent_arguments(["agent", "r1.toml", "--team=blue"])
    AgentWords(robot=PosixPath('r1.toml'), connect=None, team='blue', votes=None)
    >>> agent_arguments(["agent", "--help"]) is None
    True
    """
    if words[:1] != ["agent"]:
        return None
    options: dict[str, str] = {}
    robots = []
    rest = iter(words[1:])
    for word in rest:
        name, equals, value = word.partition("=")
        if name in ("--connect", "--team", "--votes") and name not in options:
            options[name] = value if equals else next(rest, "-")
        else:
            robots.append(word)
    if len(robots) != 1 or any(word.startswith("-") for word in (*robots, *options.values())):
        return None
    votes = options.get("--votes")
    return AgentWords(
        Path(robots[0]), options.get("--connect"), options.get("--team"), None if votes is None else Path(votes)
    )
