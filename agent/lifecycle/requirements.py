"""The order in which plugins start, and what each requires."""

from collections.abc import Mapping, Sequence
from graphlib import CycleError, TopologicalSorter

Requires = Mapping[str, Sequence[str]]
"""For each plugin the names of those that it requires."""


def start_order(requires: Requires) -> tuple[list[str], list[list[str]]]:
    """The plugins, requirements first, and the circles among them, each as the way round.

    >>> start_order({"b": ["a"], "a": []})
    (['a', 'b'], [])
    """
    graph = {name: [each for each in wanted if each in requires] for name, wanted in sorted(requires.items())}
    circles: list[list[str]] = []
    while True:
        try:
            return list(TopologicalSorter(graph).static_order()), circles
        except CycleError as error:
            circle = list(reversed(error.args[1]))
            circles.append(circle)
            for name in circle:
                graph[name] = []


def branch_of(name: str, requires: Requires) -> set[str]:
    """All that a plugin requires, also by way of others."""
    branch: set[str] = set()
    waiting = list(requires.get(name, ()))
    while waiting:
        required = waiting.pop()
        if required not in branch:
            branch.add(required)
            waiting += requires.get(required, ())
    return branch
