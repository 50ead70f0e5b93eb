"""A negotiation about tasks: a first allocation by CBBA, then rounds that release some tasks and bid for them again.

The bundle algorithm alone ends at the allocation of the sequential greedy algorithm. Each later round releases some
tasks and adds those that no robot has. They are allocated by bids again. The result is kept if all paths together are
worth about as much as in the best allocation. This is ruin and recreate (G. Schrimpf and others, Record Breaking
Optimization Results Using the Ruin and Recreate Principle, J. Computational Physics 159, 2000) with record-to-record
acceptance (G. Dueck, New Optimization Heuristics, J. Computational Physics 104, 1993). A hash selects in turn which
tasks are released: tasks near one place, or the whole routes of the robots around it (route removal: S. Ropke, D.
Pisinger, An Adaptive Large Neighborhood Search Heuristic, Transportation Science 40, 2006; proximity of strings: J.
Christiaens, G. Vanden Berghe, Slack Induction by String Removals, Transportation Science 54, 2020). In some rounds one
robot gives all its tasks to the others. Each round uses its own scores, see `RouteScorer.begin`.

Robots that run (`while_working`) begin tasks between the rounds. A robot begins a task only if all its messages of this
round leave it the task. From then on it bids more for the task than any other robot can. So no round can end that gives
the task to another robot, because all robots, including this one, would have to agree. Tasks may be begun by the last
agreed allocation, so only better allocations are continued from.

All robots choose alike, by hashes of the round's number and of the published state. This state is the robot of each
task and the value of each path. A round ends when every robot has published the same winners.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple
from zlib import crc32

import msgspec

from robrain.algorithms.consensus.bidder import Bidder, Scorer
from robrain.algorithms.consensus.chance import chance
from robrain.protocol.model.ballot import TASKS_MAX, Ballot, BidProgress

RELEASED_MIN, RELEASED_MAX = 10, 40
"""Tasks released around a place in a round (measured, as the values below: `robrain bench consensus`)."""
ROUTES_SHARE, ROUTES = 1 / 3, 2
"""Share of the rounds that release whole routes instead, and of how many robots."""
RESTS_SHARE = 0.15
"""Share of the rounds in which one robot gives its tasks away: it may be worth nothing to have it drive at all."""
SLACK = 0.03
"""Initial share by which an allocation may be worth less than the best and still be continued from. The share is 0 in
the last round."""
GAIN_MIN = 1e-6
"""Allocations must be worth more by this to replace another, against rounding."""

VALUE_MAX = 1e15
"""The greatest value that a ballot can carry."""

Apart = Callable[[str, str], float]
"""Distance between two tasks; the same for all robots."""


class _Agreed(NamedTuple):
    """An allocation that all robots have published, or may yet publish."""

    winners: Mapping[str, str]
    path: list[str]
    digest: int = 0
    value: float = -math.inf


NOTHING = _Agreed({}, [])


def digest_of(term: int, number: int, winners: Mapping[str, str]) -> int:
    """A number that distinguishes two allocations of one round."""
    text = ";".join(f"{task}={winners[task]}" for task in sorted(winners))
    return crc32(f"{term}/{number}/{text}".encode())


class Negotiation:
    """One robot's part in a negotiation.

    Args:
        robot: its name.
        scorer: values tasks for the robot.
        rounds: rounds of improvement after the first allocation.
        number: its ballots have greater numbers; after a restart, greater than before.
        while_working: whether robots begin tasks between the rounds.

    """

    def __init__(
        self, robot: str, scorer: Scorer, rounds: int, number: int = 0, *, while_working: bool = False
    ) -> None:
        self.bidder = Bidder(robot, scorer, number)
        self.term = 0
        self.round = 0
        """Rounds concluded; `rounds + 1` when the negotiation is over."""
        self._rounds, self._while_working = rounds, while_working
        self._tasks: list[str] = []
        self._apart: Apart = lambda _a, _b: 0.0
        self._team: frozenset[str] = frozenset((robot,))
        self._base = self._best = NOTHING
        """The last allocation agreed and the best: a round may start from one that is a little worse."""
        self._published: dict[int, _Agreed] = {}
        """Allocations of this round that the robot has published, by digest."""
        self._standings: dict[str, BidProgress] = {}

    def open(self, term: int, team: Iterable[str], tasks: Iterable[str], apart: Apart) -> None:
        """Begin a new negotiation.

        Args:
            term: greater than that of every earlier negotiation known to this robot.
            team: the participating robots.
            tasks: ids of the tasks to allocate.
            apart: distance between two tasks.

        """
        self.term, self.round = term, 0
        self._team = frozenset((*team, self.bidder.robot))
        self._tasks, self._apart = sorted(set(tasks))[:TASKS_MAX], apart
        self._base = self._best = NOTHING
        self._published, self._standings = {}, {}
        self.bidder.forget_begun()
        self.bidder.scorer.begin(0)
        self.bidder.open(self._tasks)

    @property
    def is_agreed(self) -> bool:
        """Whether all robots have agreed on an allocation."""
        return self.round > 0

    @property
    def is_over(self) -> bool:
        """Whether it is the last one of this negotiation."""
        return self.round > self._rounds

    @property
    def path(self) -> list[str]:
        """Tasks of this robot, in order, by the last agreed allocation; empty without one."""
        return list(self._base.path)

    @property
    def winners(self) -> dict[str, str]:
        """Robot of each allocated task, by the allocation agreed last."""
        return dict(self._base.winners)

    @property
    def value(self) -> float:
        """Value of all paths together, by the last agreed allocation."""
        return self._base.value

    def may_begin(self, task: str) -> bool:
        """Whether the robot may begin a task of its path now: it has not assigned the task to another robot."""
        robot = self.bidder.robot
        return self.is_agreed and all(one.winners.get(task) == robot for one in self._published.values())

    def begin(self, task: str) -> None:
        """The robot begins a task of its path, which `may_begin` allows; it keeps the task from now on."""
        self.bidder.begin(task)

    def ballot(self) -> Ballot:
        """Bid, and return the message for the others."""
        if not self.is_over:
            self.bidder.build()
            self._record_own()
            self._conclude()
        return msgspec.structs.replace(
            self.bidder.ballot(),
            term=self.term,
            round=self.round,
            base=self._base.digest,
            base_value=self._base.value if self.round else 0.0,
            standings=tuple(self._standings[name] for name in sorted(self._standings)),
        )

    def receive(self, ballot: Ballot) -> bool:
        """Update by another robot's ballot.

        Returns: False if it is of a later negotiation or cannot be understood, so that a new one must be opened.

        """
        if ballot.term != self.term:
            return ballot.term < self.term
        if ballot.round > self.round:
            if ballot.round > self.round + 1 or not self._follow(ballot.base, ballot.base_value):
                return False
        elif ballot.round == self.round and self.round and ballot.base != self._base.digest:
            return False
        self._record_standings(ballot.standings)
        if ballot.round == self.round and not self.is_over:
            self.bidder.receive(ballot)
        return True

    def _record_standings(self, standings: Iterable[BidProgress]) -> None:
        for one in standings:
            known = self._standings.get(one.robot)
            if one.robot != self.bidder.robot and (known is None or one.number > known.number):
                self._standings[one.robot] = one

    def _record_own(self) -> None:
        bidder = self.bidder
        winners = {task: bid.robot for task, bid in bidder.winning.items()}
        kept = self._kept()
        digest = digest_of(self.term, self.round, {**kept, **winners})
        self._published[digest] = _Agreed({**kept, **winners}, list(bidder.path), digest)
        self._standings[bidder.robot] = BidProgress(
            robot=bidder.robot,
            number=bidder.number + 1,
            round=self.round,
            digest=digest,
            value=max(-VALUE_MAX, bidder.scorer.value(bidder.path)),  # begun tasks may have made it impossible
        )

    def _kept(self) -> dict[str, str]:
        """Robots of the tasks that are not released in this round."""
        open_tasks = set(self.bidder.tasks)
        return {task: robot for task, robot in self._base.winners.items() if task not in open_tasks}

    def _conclude(self) -> None:
        """End the round if every robot has published the same allocation as this one."""
        own = self._standings[self.bidder.robot]
        values = []
        for name in sorted(self._team):
            one = self._standings.get(name)
            if one is None or (one.round, one.digest) != (self.round, own.digest):
                return
            values.append(one.value)
        value = math.fsum(values)
        if value > self._least_value():
            self._begin_round(own.digest, value)
        else:
            self._begin_round(self._base.digest, self._base.value)

    def _least_value(self) -> float:
        """Value that an allocation must exceed to be continued from: at first a little less than the best."""
        if self._best.value == -math.inf:
            return -math.inf
        left = 1.0 - self.round / self._rounds if self._rounds and not self._while_working else 0.0
        return self._best.value + GAIN_MIN - SLACK * left * abs(self._best.value)

    def _follow(self, base: int, value: float) -> bool:
        """End the round as another robot has; whether this robot knows that result."""
        if base not in self._published and not (self.round and base in (self._base.digest, self._best.digest)):
            return False
        self._begin_round(base, value)
        return True

    def _begin_round(self, digest: int, value: float) -> None:
        known = next((one for one in (self._base, self._best) if one.digest == digest), None)
        self._base = (known or self._published[digest])._replace(value=value)
        if self._while_working and self.round == 0:
            self._tasks = sorted(self._base.winners)  # all robots know these; some may not know other tasks
        if value > self._best.value:
            self._best = self._base
        self.round += 1
        self._published = {}
        if self.is_over:
            self._base = self._best
            self.bidder.open((), self._base.path)
            return
        self.bidder.scorer.begin(self.round)
        rests = self._resting()
        released = self._released() | {task for task, robot in self._base.winners.items() if robot == rests}
        fixed = [task for task in self._base.path if task not in released]
        self.bidder.open(released, fixed, rests=rests == self.bidder.robot)

    def _drawn(self, what: str) -> float:
        """A number from 0 to 1 for a choice of this round; the same for all robots."""
        return chance(self.term, self.round, what)

    def _resting(self) -> str:
        """The robot that takes no tasks in this round; empty if all do."""
        if len(self._team) < 2 or self._while_working or self._drawn("rests") >= RESTS_SHARE:
            return ""
        return sorted(self._team)[int(self._drawn("who") * len(self._team))]

    def _released(self) -> set[str]:
        """The tasks that this round allocates again: some around one place, and those that no robot has."""
        tasks, apart, winners = self._tasks, self._apart, self._base.winners
        if not tasks:
            return set()
        centre = tasks[int(self._drawn("centre") * len(tasks))]
        near = sorted(tasks, key=lambda task: (apart(centre, task), task))
        if self._drawn("routes") < ROUTES_SHARE:
            robots = list(dict.fromkeys(winners[task] for task in near if task in winners))[:ROUTES]
            released = {task for task in tasks if winners.get(task) in robots}
        else:
            released = {*near[: RELEASED_MIN + int(self._drawn("count") * (RELEASED_MAX - RELEASED_MIN + 1))]}
        return released | {task for task in tasks if task not in winners}
