"""Teams that bid over a graph of who hears whom, with messages lost, repeated, late and out of order."""

import math
import random
from collections.abc import Mapping, Sequence
from itertools import combinations, product
from typing import NamedTuple

from robrain.algorithms.consensus.bidder import Bidder, Insertion
from robrain.protocol.model.ballot import Ballot


class Coverage:
    """A submodular score: a task covers points, each of which counts once for the robot."""

    def __init__(self, covers: Mapping[str, frozenset[int]], weights: Sequence[float]) -> None:
        self._covers = covers
        self._weights = weights

    def value(self, path: Sequence[str]) -> float:
        covered = frozenset[int]().union(*(self._covers[task] for task in path))
        return math.fsum(self._weights[point] for point in sorted(covered))

    def begin(self, variant: int) -> None:
        assert variant == 0

    def keep_first(self, count: int) -> None:
        assert count == 0

    def insertion(self, path: Sequence[str], task: str) -> Insertion:
        return Insertion(self.value([*path, task]) - self.value(path), len(path))

    def ordered(self, path: Sequence[str]) -> list[str]:
        return list(path)


class Team(NamedTuple):
    scorers: dict[str, Coverage]
    tasks: list[str]
    edges: set[tuple[str, str]]
    """Both directions of each."""

    @property
    def diameter(self) -> int:
        names = list(self.scorers)
        far: dict[tuple[str, str], float] = dict.fromkeys(product(names, names), math.inf)
        far.update(dict.fromkeys(self.edges, 1))
        far.update({(name, name): 0 for name in names})
        for via, one, other in product(names, repeat=3):
            far[one, other] = min(far[one, other], far[one, via] + far[via, other])
        return int(max(far.values()))


def drawn_team(seed: int, *, robots: int = 4, tasks: int = 6, distinct: bool = True) -> Team:
    """A connected graph, and scores without ties if `distinct`."""
    rng = random.Random(seed)
    names = [f"r{number}" for number in range(robots)]
    open_tasks = [f"t{number}" for number in range(tasks)]
    points = 2 * tasks + 4
    scorers = {
        name: Coverage(
            {task: frozenset(rng.sample(range(points), rng.randint(1, 4))) for task in open_tasks},
            [rng.random() + 0.01 if distinct else float(rng.randint(0, 3)) for _ in range(points)],
        )
        for name in names
    }
    edges = {(names[index], names[rng.randrange(index)]) for index in range(1, robots)}
    edges |= {pair for pair in combinations(names, 2) if rng.random() < 0.2}
    return Team(scorers, open_tasks, edges | {(other, one) for one, other in edges})


def bidders_of(team: Team) -> dict[str, Bidder]:
    bidders = {name: Bidder(name, scorer) for name, scorer in team.scorers.items()}
    for bidder in bidders.values():
        bidder.open(team.tasks)
    return bidders


def exchange(team: Team, bidders: Mapping[str, Bidder], is_lost=lambda: False) -> bool:
    """Everybody bids and then hears its neighbours; whether an opinion changed."""
    changed = [bidder.build() for bidder in bidders.values()]
    ballots = {name: bidder.ballot() for name, bidder in bidders.items()}
    heard = [bidders[receiver].receive(ballots[sender]) for sender, receiver in sorted(team.edges) if not is_lost()]
    return any(changed) or any(heard)


def settle(team: Team, bidders: Mapping[str, Bidder], is_lost=lambda: False, quiet: int = 1, limit: int = 500) -> int:
    """Exchanges until nothing has changed for `quiet` of them."""
    still = 0
    for count in range(1, limit):
        still = 0 if exchange(team, bidders, is_lost) else still + 1
        if still == quiet:
            return count - quiet
    raise AssertionError(f"expected bids to settle within {limit} exchanges")


def paths_of(bidders: Mapping[str, Bidder]) -> dict[str, list[str]]:
    return {name: sorted(bidder.path) for name, bidder in bidders.items()}


def greedy(team: Team) -> dict[str, list[str]]:
    """The sequential greedy algorithm: the greatest gain of any robot by any task, again and again."""
    paths: dict[str, list[str]] = {name: [] for name in team.scorers}
    left = list(team.tasks)
    while True:
        found = [
            (-gain, name, task)
            for name, task in product(paths, left)
            if (gain := team.scorers[name].insertion(paths[name], task).gain) > 0
        ]
        if not found:
            return {name: sorted(path) for name, path in paths.items()}
        _, name, task = min(found)
        paths[name].append(task)
        left.remove(task)


def agree(bidders: Mapping[str, Bidder]) -> bool:
    opinions = [bidder.winning for bidder in bidders.values()]
    return all(opinion == opinions[0] for opinion in opinions)


def without_conflicts(bidders: Mapping[str, Bidder]) -> bool:
    tasks = [task for bidder in bidders.values() for task in bidder.path]
    return len(tasks) == len(set(tasks))


class Post:
    """Delivers ballots late, in any order, twice, or not at all."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng
        self._waiting: list[tuple[str, Ballot]] = []

    def send(self, team: Team, ballot: Ballot) -> None:
        for sender, receiver in sorted(team.edges):
            if sender == ballot.robot and self._rng.random() > 0.2:
                self._waiting += [(receiver, ballot)] * self._rng.choice((1, 1, 2))

    def deliver(self, bidders: Mapping[str, Bidder]) -> bool:
        self._rng.shuffle(self._waiting)
        count = self._rng.randint(0, len(self._waiting))
        changed = [bidders[receiver].receive(ballot) for receiver, ballot in self._waiting[:count]]
        self._waiting = self._waiting[count:][-200:]
        return any(changed)
