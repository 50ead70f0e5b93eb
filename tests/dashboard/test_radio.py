"""Who hears whom on the dashboard's picture."""

from robrain.dashboard.state.focus import Focus, motes_in_focus
from robrain.dashboard.state.radio_links import (
    DrawnLink,
    best_links,
    links_in_focus,
    links_of_robot,
    robot_pairs,
    team_links,
)
from robrain.dashboard.state.shown_robot import ShownMote, ShownRobot
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.border.border import Received
from robrain.protocol.messages.robots.robot_messages import ROBOT_LINKS, RadioLink, RobotLinks, RobotState
from robrain.protocol.model.geometry import Point2D, Pose2D
from tests.mote_readings import reading

NOW_S = 10.0


def team(**places_x_m: float) -> ShownTeam:
    """Robots at these places, heard just now."""
    view = ShownTeam()
    for name, x_m in places_x_m.items():
        robot = view.robots[name] = ShownRobot(name, 0, present=True)
        robot.handle_state(RobotState(robot=name, pose=Pose2D(x_m, 0.0, 0.0)), NOW_S)
    return view


def tell(view: ShownTeam, robot: str, **heard_dbm: float) -> None:
    """A robot says whom it hears: robots by names with r, motes by names with m."""
    links = [
        RadioLink(peer=peer, is_robot=peer.startswith("r"), rssi_dbm=rssi_dbm, last_seen_ns=1)
        for peer, rssi_dbm in heard_dbm.items()
    ]
    key = ROBOT_LINKS.key("default", robot=robot)
    view.apply(Received(ROBOT_LINKS, key, {"robot": robot}, RobotLinks(robot=robot, links=links)), NOW_S)


def ends(links: list[DrawnLink]) -> set[tuple[float, float]]:
    return {(min(link.start.x_m, link.end.x_m), max(link.start.x_m, link.end.x_m)) for link in links}


def test_links_between_robots_are_as_strong_as_their_worse_direction() -> None:
    view = team(r1=1.0, r2=2.0)
    tell(view, "r1", r2=-60.0, r9=-50.0, r1=-10.0)
    assert robot_pairs(view, NOW_S) == {("r1", "r2"): -60.0}
    tell(view, "r2", r1=-85.0)
    assert robot_pairs(view, NOW_S) == {("r1", "r2"): -85.0}
    tell(view, "r1")
    tell(view, "r2")
    assert robot_pairs(view, NOW_S) == {}


def test_team_is_held_together_by_its_strongest_links_alone() -> None:
    view = team(r1=1.0, r2=2.0, r3=3.0, r4=4.0, r5=5.0)
    tell(view, "r1", r2=-60.0, r3=-80.0)
    tell(view, "r2", r3=-65.0)
    tell(view, "r4", r5=-90.0)
    assert ends(team_links(view, NOW_S)) == {(1.0, 2.0), (2.0, 3.0), (4.0, 5.0)}
    assert team_links(team(r1=1.0), NOW_S) == []


def test_selected_robot_shows_all_that_it_hears() -> None:
    view = team(r1=1.0, r2=2.0)
    for name, x_m in (("m1", -1.0), ("m2", -2.0), ("m3", -3.0)):
        view.motes[name] = ShownMote(name, place=Point2D(x_m, 0.0))
    view.motes["m2"].receive(reading("m2", rssi_dbm=-88.0, stamp_ns=5))
    view.motes["m2"].place = Point2D(-2.0, 0.0)
    tell(view, "r1", m1=-70.0, r2=-60.0, m7=-50.0)
    tell(view, "r2", m3=-70.0)
    assert ends(links_of_robot(view, "r1", NOW_S)) == {(-1.0, 1.0), (-2.0, 1.0), (1.0, 2.0)}
    assert links_of_robot(view, "r7", NOW_S) == []
    # The team's own links are on everybody's picture already.
    assert ends(links_in_focus(view, Focus("r1", chosen=True), NOW_S)) == {(-1.0, 1.0), (-2.0, 1.0)}
    (best,) = best_links(view, view.motes.values())
    assert best.rssi_dbm == -88.0


def test_motes_have_neither_label_nor_link_until_somebody_zooms_in_or_selects() -> None:
    view = team(r1=1.0, r2=2.0)
    for number in range(1, 4):
        name = f"m{number}"
        view.motes[name] = ShownMote(name)
        via = "r1" if number == 1 else "r2"
        view.motes[name].receive(reading(name, place=Point2D(10.0 * number, 0.0), via=via, stamp_ns=5))

    def seen(focus: Focus) -> tuple[list[str], int]:
        return [mote.name for mote in motes_in_focus(view, focus)], len(links_in_focus(view, focus, NOW_S))

    assert seen(Focus()) == ([], 0)
    assert seen(Focus("r1")) == ([], 0)  # preselected by the page
    assert seen(Focus("r1", chosen=True)) == (["m1"], 1)
    assert seen(Focus("r2", chosen=True)) == (["m2", "m3"], 2)
    assert seen(Focus(mote="m3")) == (["m3"], 1)
    assert seen(Focus(mote="m9")) == ([], 0)
    assert seen(Focus(middle=Point2D(21.0, 0.0), reach_m=9.5)) == (["m2", "m3"], 2)
