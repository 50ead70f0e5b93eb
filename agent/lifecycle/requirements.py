"""Requirements: in which order plugins start, and what is missing, from who requires whom."""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
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


def path_to_missing(name: str, requires: Callable[[str], Sequence[str]], is_there: Callable[[str], bool]) -> list[str]:
    """From a plugin, by what each requires, to the first that is not there; empty if all are."""
    paths, seen = deque([[name]]), {name}
    while paths:
        path = paths.popleft()
        for required in requires(path[-1]):
            if not is_there(required):
                return [*path, required]
            if required not in seen:
                seen.add(required)
                paths.append([*path, required])
    return []
