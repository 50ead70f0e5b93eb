"""Links of the motes' radio and their strength, from readings and from the robots' base stations."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from robrain.dashboard.state.focus import Focus, motes_in_focus
from robrain.dashboard.state.shown_robot import RobotContact, ShownMote
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import RELAY, Relay
from robrain.protocol.model.tasks.task import BadParameters, parameters_of


class DrawnLink(NamedTuple):
    """A radio link between two places, arena frame."""

    start: Point2D
    end: Point2D
    rssi_dbm: float


def best_links(view: ShownTeam, motes: Iterable[ShownMote]) -> list[DrawnLink]:
    """The strongest of the newest links of each of these motes; drawing all links would hide all other objects."""
    found = []
    for mote in motes:
        link = max(mote.links.values(), key=lambda link: (link.stamp_ns, link.rssi_dbm), default=None)
        end = place_of_robot(view, link.via) if link is not None else None
        if link is not None and mote.place is not None and end is not None:
            found.append(DrawnLink(mote.place, end, link.rssi_dbm))
    return found


def links_of_robot(view: ShownTeam, name: str, now_s: float) -> list[DrawnLink]:
    """All links of a robot: motes by its base station's list or by their readings, and other robots."""
    here = place_of_robot(view, name)
    if here is None:
        return []
    received = {link.peer: link.rssi_dbm for link in view.robots[name].links if not link.is_robot}
    for mote in view.motes.values():
        if mote.name not in received and name in mote.links:
            received[mote.name] = mote.links[name].rssi_dbm
    found = []
    for peer, rssi_dbm in received.items():
        known = view.motes.get(peer)
        if known is not None and known.place is not None:
            found.append(DrawnLink(known.place, here, rssi_dbm))
    for (one, other), rssi_dbm in robot_pairs(view, now_s).items():
        there = place_of_robot(view, other if one == name else one)
        if name in (one, other) and there is not None:
            found.append(DrawnLink(here, there, rssi_dbm))
    return found


def links_in_focus(view: ShownTeam, focus: Focus, now_s: float) -> list[DrawnLink]:
    """All links of a robot selected by a person, and the best link of each mote in focus, without duplicates.

    Links that are drawn for all browsers are left out.
    """
    drawn = {frozenset((link.start, link.end)) for link in team_links(view, now_s)}
    found: list[DrawnLink] = []
    of_robot = links_of_robot(view, focus.robot, now_s) if focus.chosen else []
    of_motes = best_links(view, motes_in_focus(view, focus._replace(chosen=False)))
    for link in (*of_robot, *of_motes):
        line = frozenset((link.start, link.end))
        if line not in drawn:
            drawn.add(line)
            found.append(link)
    return found


def team_links(view: ShownTeam, now_s: float) -> list[DrawnLink]:
    """The fewest and strongest links that hold the team's radio together: a maximum spanning forest by strength."""
    found = []
    for (one, other), rssi_dbm in spanning_forest(robot_pairs(view, now_s)).items():
        start, end = place_of_robot(view, one), place_of_robot(view, other)
        if start is not None and end is not None:
            found.append(DrawnLink(start, end, rssi_dbm))
    return found


def spanning_forest(pairs: Mapping[tuple[str, str], float]) -> dict[tuple[str, str], float]:
    """The pairs of a maximum spanning forest, strongest first (Kruskal 1956).

    Own code for ten lines: SciPy's needs as long to load as the rest of the page's scene.
    """
    group = {name: name for pair in pairs for name in pair}
    forest = {}
    for pair, strength in sorted(pairs.items(), key=lambda item: (-item[1], item[0])):
        one, other = (_group_of(group, name) for name in pair)
        if one != other:
            group[one] = other
            forest[pair] = strength
    return forest


def _group_of(group: dict[str, str], name: str) -> str:
    while group[name] != name:
        group[name] = name = group[group[name]]
    return name


def robot_pairs(view: ShownTeam, now_s: float) -> dict[tuple[str, str], float]:
    """Strength in dBm between two robots that are there, by sorted names: of the worse direction that is known."""
    pairs: dict[tuple[str, str], float] = {}
    there = {robot.name for robot in view.robots.values() if robot.contact(now_s) is not RobotContact.LOST}
    for robot in view.robots.values():
        for link in robot.links:
            if link.is_robot and link.peer != robot.name and {link.peer, robot.name} <= there:
                one, other = sorted((robot.name, link.peer))
                pairs[one, other] = min(link.rssi_dbm, pairs.get((one, other), link.rssi_dbm))
    return pairs


def mote_routes(view: ShownTeam) -> list[tuple[Point2D, Point2D]]:
    """From each mote to the mote or gateway that receives its readings, according to its latest reading."""
    lines = []
    for mote in view.motes.values():
        following = view.motes.get(mote.next_hop)
        if following is not None and following is not mote and mote.place is not None and following.place is not None:
            lines.append((mote.place, following.place))
    return lines


def relay_lines(view: ShownTeam) -> list[tuple[Point2D, Point2D]]:
    """From each robot that is a relay now to its mote, and to the robot that is next in the chain."""
    lines = []
    for event in view.tasks.values():
        task, here = event.task, place_of_robot(view, event.robot)
        if task.kind != RELAY or here is None:
            continue
        try:
            relay = parameters_of(task, Relay)
        except BadParameters:
            continue
        mote = view.motes.get(relay.mote)
        ends = (mote.place if mote is not None else None, place_of_robot(view, relay.robot))
        lines += [(here, end) for end in ends if end is not None]
    return lines


def place_of_robot(view: ShownTeam, name: str) -> Point2D | None:
    """The place of a robot; None if it is not known."""
    robot = view.robots.get(name)
    pose = robot.pose if robot is not None else None
    return None if pose is None else Point2D(pose.x_m, pose.y_m)
