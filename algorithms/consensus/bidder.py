"""One robot of the consensus-based bundle algorithm (CBBA) of Choi, Brunet and How 2009: it bids and agrees.

A bundle is built greedily. The candidate is the task whose best insertion into the robot's path gains most. The robot
bids for this task if the bid beats the best known bid. A robot that is outbid for a task releases this task and all
tasks that it added to its bundle later. The bids for those tasks assumed the lost task. The robot then bids again. A
bid is never greater than the preceding bid in the bundle. Therefore the rounds converge for every score, also for one
that grows with the path (L. Johnson, H.-L. Choi, S. Ponda, J. P. How, Allowing Non-Submodular Score Functions in
Distributed Task Allocation, CDC 2012).
"""

import math
from collections.abc import Callable, Iterable, Sequence
from enum import StrEnum
from typing import NamedTuple, Protocol

from robrain.protocol.model.ballot import TASKS_MAX, Ballot, Bid, SeenBallot

IsNewer = Callable[[str], bool]
"""Whether the sender knows a later ballot of a robot than the receiver does."""


class BidAction(StrEnum):
    """Effect of a ballot on the receiver's own opinion."""

    UPDATE = "update"
    """Adopt the sender's bid."""
    RESET = "reset"
    """Forget it: no winner of the task is known."""
    LEAVE = "leave"


def action_for(receiver: str, sender: str, mine: Bid | None, theirs: Bid | None, is_newer: IsNewer) -> BidAction:
    """Action of the receiver of a ballot for one task.

    Args:
        receiver: name of the robot that received the ballot.
        sender: name of the robot that sent it.
        mine: the receiver's winning bid; None if it knows none.
        theirs: the sender's.
        is_newer: whether the sender has more recent information about a robot.

    """
    holder = None if mine is None else mine.robot
    winner = None if theirs is None else theirs.robot
    is_mine_old = holder is not None and is_newer(holder)
    is_greater = theirs is not None and theirs.beats(mine)
    if winner == sender:
        is_adopted = holder in (None, sender) or is_greater or (holder != receiver and is_mine_old)
        return BidAction.UPDATE if is_adopted else BidAction.LEAVE
    if winner is None or winner == receiver:
        if holder in (None, receiver) or not (holder == sender or is_mine_old):
            return BidAction.LEAVE
        return BidAction.UPDATE if winner is None else BidAction.RESET
    is_fresh = is_newer(winner)
    if holder in (None, winner):
        return BidAction.UPDATE if is_fresh else BidAction.LEAVE
    if holder == receiver:
        return BidAction.UPDATE if is_fresh and is_greater else BidAction.LEAVE
    if holder == sender:
        return BidAction.UPDATE if is_fresh else BidAction.RESET
    if is_fresh and (is_mine_old or is_greater):
        return BidAction.UPDATE
    return BidAction.RESET if is_mine_old else BidAction.LEAVE


class Insertion(NamedTuple):
    """The best place of a task in a path."""

    gain: float
    """Increase of the path's value with the task, or another measure, see `Scorer.begin`. The robot does not bid for a
    gain of 0."""
    position: int
    """Index that the task gets in the path."""


class Scorer(Protocol):
    """Values tasks for one robot."""

    def begin(self, variant: int) -> None:
        """Change the score from now on; variant 0 is the plain gain, equal variants score alike."""

    def insertion(self, path: Sequence[str], task: str) -> Insertion | None:
        """The best insertion of a task into a path; None if the robot cannot do it then."""

    def ordered(self, path: Sequence[str]) -> list[str]:
        """The same tasks in an order that is worth at least as much."""

    def value(self, path: Sequence[str]) -> float:
        """Value of a path."""

    def keep_first(self, count: int) -> None:
        """From now on the first `count` tasks of every path stay where they are: the robot has begun them."""


BEGUN_SCORE = 1e15
"""Bid for a task that the robot has begun: the greatest that a ballot can carry."""


class Bidder:
    """A robot that allocates tasks with others.

    If scores have diminishing gains, equal ballots lead to one allocation. Ballots may arrive in any order and any
    number of times, and any of them may be lost. The allocation is that of the sequential greedy algorithm, worth at
    least half of the optimum.

    Args:
        robot: its name.
        scorer: values tasks for the robot.
        number: its ballots have greater numbers; after a restart, greater than before.

    """

    def __init__(self, robot: str, scorer: Scorer, number: int = 0) -> None:
        self.robot = robot
        self.scorer = scorer
        self.bundle: list[str] = []
        """Tasks that it bids for, in the order of the bids."""
        self.path: list[str] = []
        """The same in the order in which it would do them."""
        self.winning: dict[str, Bid] = {}
        """The best bid known of each task that has one."""
        self.received: dict[str, int] = {}
        """Number of the last ballot of each other robot that is taken into account."""
        self.limit: int | None = None
        """The most tasks of its path, those that are fixed included; None for any number."""
        self.is_resting = False
        """Whether it bids for nothing until `open` is called again."""
        self.number = number
        """Of its last ballot."""
        self.tasks: list[str] = []
        """The tasks that are open for bids, sorted."""
        self._fixed: list[str] = []
        self.begun: list[str] = []
        """Tasks that the robot has begun, in that order; no other robot gets them."""
        self._is_stale = True
        """Whether an opinion has changed since the bundle was built."""

    def open(self, tasks: Iterable[str], fixed: Sequence[str] = (), *, rests: bool = False) -> None:
        """Bid for these tasks from now on; all earlier bids are forgotten.

        Args:
            tasks: ids, at most 256; of more the first ones by name count.
            fixed: path of tasks that the robot does in any case and that receive no bids.
            rests: whether it leaves all of them to the others.

        """
        self.is_resting = rests
        self.tasks = sorted(set(tasks))[:TASKS_MAX]
        self._fixed = list(fixed)
        self.winning, self.received, self.bundle = {}, {}, []
        self.path = self.scorer.ordered(self._first())
        self._is_stale = True

    def begin(self, task: str) -> None:
        """The robot begins a task of its path: it keeps it, before all that it has not begun."""
        self.begun = [*(one for one in self.begun if one != task), task]
        self.scorer.keep_first(len(self.begun))
        self._is_stale = True

    def forget_begun(self) -> None:
        """Begin a new negotiation, which excludes the robot's begun tasks."""
        self.begun = []
        self.scorer.keep_first(0)

    def build(self) -> bool:
        """Build the bundle again if an opinion has changed; returns whether the robot's own bids have changed.

        The paper only adds to the bundle. With that rule, consider a task that is free again because its winner was
        outbid for an earlier task. The robot would bid for it as an addition to all tasks that replaced it. The result
        would depend on the order of messages.
        """
        if not self._is_stale:
            return False
        self._is_stale = False
        before = {task: bid for task, bid in self.winning.items() if bid.robot == self.robot}
        self.winning = {task: bid for task, bid in self.winning.items() if bid.robot != self.robot}
        self.bundle, self.path = [], self.scorer.ordered(self._first())
        limit = math.inf
        for task in self.begun:
            if task in self.tasks:
                self.winning[task] = Bid(task=task, robot=self.robot, score=BEGUN_SCORE)
                self.bundle.append(task)
        most = 0 if self.is_resting else self.limit and max(0, self.limit - len(self._fixed))
        while (best := None if most is not None and len(self.bundle) >= most else self._best(limit)) is not None:
            bid, found = best
            self.bundle.append(bid.task)
            # Here, not once none wins: whether one wins depends on lesser bids, and greater ones would then on those.
            self.path = self.scorer.ordered([*self.path[: found.position], bid.task, *self.path[found.position :]])
            self.winning[bid.task] = bid
            limit = bid.score
        return before != {task: self.winning[task] for task in self.bundle}

    def _first(self) -> list[str]:
        """Tasks that are always in the robot's path: begun tasks, and fixed tasks without bids."""
        return [*self.begun, *(task for task in self._fixed if task not in self.begun)]

    def _best(self, limit: float) -> tuple[Bid, Insertion] | None:
        """The winning bid of greatest gain for one more task, at most `limit`; None if no bid wins."""
        best: tuple[Bid, Insertion] | None = None
        for task in self.tasks:
            known = self.winning.get(task)
            if known is not None and (known.robot == self.robot or known.score > limit):
                continue
            found = self.scorer.insertion(self.path, task)
            if found is None or not found.gain > 0 or (best is not None and not found.gain > best[1].gain):
                continue
            bid = Bid(task=task, robot=self.robot, score=min(found.gain, limit))
            if bid.beats(known):
                best = bid, found
        return best

    def ballot(self) -> Ballot:
        """The present ballot for the other robots."""
        self.number += 1
        bids = tuple(self.winning[task] for task in sorted(self.winning))
        received = tuple(SeenBallot(robot=robot, number=self.received[robot]) for robot in sorted(self.received))
        return Ballot(robot=self.robot, number=self.number, bids=bids, received=received)

    def receive(self, ballot: Ballot) -> bool:
        """Update by another robot's ballot; returns whether an opinion changed.

        Repeated and old ones do not.
        """
        sender = ballot.robot
        if sender == self.robot or ballot.number <= self.received.get(sender, -1):
            return False
        proposed = {bid.task: bid for bid in ballot.bids}
        numbers = {one.robot: one.number for one in ballot.received} | {sender: ballot.number}
        numbers.pop(self.robot, None)

        def is_newer(robot: str) -> bool:
            return numbers.get(robot, -1) > self.received.get(robot, -1)

        changed = []
        for task in sorted({*self.winning, *proposed}):
            mine, theirs = self.winning.get(task), proposed.get(task)
            match action_for(self.robot, sender, mine, theirs, is_newer):
                case BidAction.UPDATE if theirs is not None:
                    self.winning[task] = theirs
                case BidAction.UPDATE | BidAction.RESET:
                    self.winning.pop(task, None)
                case BidAction.LEAVE:
                    continue
            if self.winning.get(task) != mine:
                changed.append(task)
        for robot, number in numbers.items():
            self.received[robot] = max(self.received.get(robot, -1), number)
        self._is_stale |= bool(changed)
        return bool(changed)

    def forget(self, robot: str) -> None:
        """A robot has vanished: the tasks that it won are open again. A later ballot of it counts again."""
        self.winning = {task: bid for task, bid in self.winning.items() if bid.robot != robot}
        self._is_stale = True
