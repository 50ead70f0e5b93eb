"""Plans paths of many robots that do not collide, on a graph of places: LaCAM*.

K. Okumura, *LaCAM: Search-Based Algorithm for Quick Multi-Agent Pathfinding*, AAAI 2023, and *Improving LaCAM for
Scalable Eventually Optimal Multi-Agent Pathfinding*, IJCAI 2023. A search over joint positions, whose next joint
position is made by PIBT (Okumura et al., Artificial Intelligence 310, 2022), under constraints that are added one by
one. In a step each robot moves to a neighbouring place or stays; no two are at one place, and no two swap places.
"""

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

Joint = tuple[int, ...]
"""The place of each robot."""


class _Constraint(NamedTuple):
    """Places that some robots must take in the next step."""

    robots: tuple[int, ...] = ()
    places: tuple[int, ...] = ()


class _Node:
    """A joint position that the search has found, and what is known of the steps from it."""

    def __init__(self, joint: Joint, parent: "_Node | None", cost: float, ages: list[float]) -> None:
        self.joint = joint
        self.parent = parent
        self.cost = cost
        self.ages = ages
        """Steps since each robot was at its goal, and a part below 1 that orders robots of one age."""
        self.order = sorted(range(len(joint)), key=lambda robot: -ages[robot])
        self.constraints = deque([_Constraint()])
        self.steps: dict[Joint, _Node] = {}
        """Joint positions that were reached from here."""


class TeamPaths:
    """Plans on one graph.

    Args:
        neighbours: the places that can be reached from each place in one step.

    """

    def __init__(self, neighbours: Sequence[Sequence[int]]) -> None:
        self._neighbours = neighbours
        self._distances: dict[int, list[int]] = {}

    def distances(self, goal: int) -> list[int]:
        """Number of steps from each place to a goal; the number of places if there is no path."""
        known = self._distances.get(goal)
        if known is None:
            known = self._distances[goal] = [len(self._neighbours)] * len(self._neighbours)
            known[goal] = 0
            queue = deque([goal])
            while queue:
                place = queue.popleft()
                for near in self._neighbours[place]:
                    if known[near] > known[place] + 1:
                        known[near] = known[place] + 1
                        queue.append(near)
        return known

    def plan(self, starts: Joint, goals: Joint, seed: int, steps_max: int) -> list[Joint] | None:
        """Joint positions from the starts to the goals; None if none were found.

        Args:
            starts: place of each robot; no two are equal.
            goals: its goal; no two are equal.
            seed: breaks ties between places.
            steps_max: number of joint steps that the search tries. A larger number shortens the paths.

        """
        search = _Search(self._neighbours, [self.distances(goal) for goal in goals], goals, seed)
        return search.run(starts, steps_max)


class _Search:
    def __init__(
        self, neighbours: Sequence[Sequence[int]], distances: list[list[int]], goals: Joint, seed: int
    ) -> None:
        self._neighbours = neighbours
        self._distances = distances
        self._goals = goals
        self._rng = np.random.default_rng(seed)
        self._ties: list[float] = []
        self._now: dict[int, int] = {}
        self._next: dict[int, int] = {}
        """The robot at each place, before and after the step that is made."""
        self._to: list[int] = []
        """The place of each robot after this step; −1 if it is open."""

    def run(self, starts: Joint, steps_max: int) -> list[Joint] | None:
        count = len(starts)
        first = _Node(starts, None, 0.0, [self._distances[robot][place] / 1e6 for robot, place in enumerate(starts)])
        nodes, stack, goal = {starts: first}, [first], None
        for _ in range(steps_max):
            while stack and (not stack[-1].constraints or (goal is not None and self._least(stack[-1]) >= goal.cost)):
                stack.pop()
            if not stack:
                break
            node = stack[-1]
            if node.joint == self._goals and goal is None:
                goal = node
                continue
            constraint = node.constraints.popleft()
            depth = len(constraint.robots)
            if depth < count:
                robot = node.order[depth]
                places = [*self._neighbours[node.joint[robot]], node.joint[robot]]
                for index in self._rng.permutation(len(places)).tolist():
                    node.constraints.append(
                        _Constraint((*constraint.robots, robot), (*constraint.places, places[index]))
                    )
            joint = self._step(node, constraint)
            if joint is None:
                continue
            known = nodes.get(joint)
            if known is None:
                ages = [
                    age % 1.0 if place == self._goals[robot] else age + 1.0
                    for robot, (place, age) in enumerate(zip(joint, node.ages, strict=True))
                ]
                known = nodes[joint] = _Node(joint, node, node.cost + self._cost(node.joint, joint), ages)
                node.steps[joint] = known
                stack.append(known)
            else:
                node.steps[joint] = known
                self._improve(node)
                # A step that repeats itself is left by starting again now and then (Okumura, IJCAI 2023).
                stack.append(known if self._rng.random() >= RESTART else first)
        return None if goal is None else _path(goal)

    def _cost(self, joint: Joint, then: Joint) -> float:
        """Robots that are not at their goals, or leave them."""
        return sum(not (place == after == goal) for place, after, goal in zip(joint, then, self._goals, strict=True))

    def _least(self, node: _Node) -> float:
        return node.cost + sum(distance[place] for distance, place in zip(self._distances, node.joint, strict=True))

    def _improve(self, node: _Node) -> None:
        """Lower the costs of all that are reached from a node, where its costs now permit."""
        queue = deque([node])
        while queue:
            one = queue.popleft()
            for joint, then in one.steps.items():
                cost = one.cost + self._cost(one.joint, joint)
                if cost < then.cost:
                    then.cost, then.parent = cost, one
                    queue.append(then)

    def _step(self, node: _Node, constraint: _Constraint) -> Joint | None:
        """A joint step by PIBT; None if the constraint does not permit one."""
        self._from = node.joint
        self._now = {place: robot for robot, place in enumerate(node.joint)}
        self._next, self._to, self._is_possible = {}, [-1] * len(node.joint), True
        for robot, place in zip(constraint.robots, constraint.places, strict=True):
            if place in self._next or self._swaps(robot, place):
                return None
            self._next[place], self._to[robot] = robot, place
        self._ties = self._rng.random(5 * len(node.joint)).tolist()
        for robot in node.order:
            if self._to[robot] < 0:
                self._move(robot, robot)
            if not self._is_possible:
                return None
        return tuple(self._to)

    def _swaps(self, robot: int, place: int) -> bool:
        other = self._now.get(place, robot)
        return other != robot and self._to[other] == self._from[robot]

    def _move(self, robot: int, by: int) -> bool:
        """Give a robot its next place; robots that are in its way move first.

        A robot that cannot move stays, and then the robot `by` that pushes it does not get its place: False.
        """
        here, distance = self._from[robot], self._distances[robot]
        ties = self._ties[5 * robot : 5 * robot + 5]
        near = [*self._neighbours[here], here]
        ranked = sorted((distance[place], tie, place) for place, tie in zip(near, ties, strict=False))
        places = [place for _, _, place in ranked]
        partner = self._partner(robot, places[0])
        if partner >= 0:
            places.reverse()
        for place in places:
            if place in self._next or self._swaps(robot, place):
                continue
            self._next[place], self._to[robot] = robot, place
            other = self._now.get(place, robot)
            if other == robot or self._to[other] >= 0 or self._move(other, robot):
                if partner >= 0 and place == places[0] and self._to[partner] < 0 and here not in self._next:
                    self._next[here], self._to[partner] = partner, here
                return True
        if self._next.get(here, by) != by:
            self._is_possible = False  # by the constraint another robot comes here
        self._next[here], self._to[robot] = robot, here
        return False

    def _partner(self, robot: int, best: int) -> int:
        """The robot that has to swap places with this one in a passage, and can do so behind it; −1 if there is none.

        This robot then leaves the passage backwards and pulls the other one after it.
        """
        here = self._from[robot]
        if best == here:
            return -1
        other = self._now.get(best, -1)
        if (
            other >= 0
            and self._to[other] < 0
            and self._must_swap(robot, other, here, best)
            and self._can_swap(best, here)
        ):
            return other
        for near in self._neighbours[here]:
            other = self._now.get(near, -1)
            if other >= 0 and near != best and self._must_swap(other, robot, here, best) and self._can_swap(best, here):
                return other
        return -1

    def _must_swap(self, robot: int, other: int, place: int, ahead: int) -> bool:
        """Whether a robot that pushes another along a passage never comes past it, and the other wants to come back."""
        own, others = self._distances[robot], self._distances[other]
        while own[ahead] < own[place]:
            exits = self._exits(ahead, place)
            if len(exits) > 1:
                return False
            if not exits:
                break
            place, ahead = ahead, exits[0]
        return others[place] < others[ahead] and (own[place] == 0 or own[ahead] < own[place])

    def _can_swap(self, place: int, behind: int) -> bool:
        """Whether a passage, followed backwards, leads to a place where one robot can let another one past."""
        first = place
        while behind != first:
            exits = self._exits(behind, place)
            if len(exits) != 1:
                return len(exits) > 1
            place, behind = behind, exits[0]
        return False

    def _exits(self, place: int, without: int) -> list[int]:
        """Neighbours of a place, without the one from which it is entered and dead ends where a robot stays."""
        return [
            near
            for near in self._neighbours[place]
            if near != without
            and not (len(self._neighbours[near]) == 1 and near in self._now and self._goals[self._now[near]] == near)
        ]


RESTART = 0.001
"""Probability of starting again from the first joint position after a known one was reached."""


def _path(node: _Node | None) -> list[Joint]:
    found = []
    while node is not None:
        found.append(node.joint)
        node = node.parent
    return found[::-1]
