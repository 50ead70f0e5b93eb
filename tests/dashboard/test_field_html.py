"""The mote field, the rules, unexplored regions and moving bodies, as the page shows them."""

from typing import Any

import msgspec

from robrain.dashboard.html.team_html import field_html, left_html, missions_html, motes_html, rules_html
from robrain.dashboard.state.radio_links import mote_routes
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.maps.map_messages import COORDINATOR_LEFT, ExplorationLeft, LeftKind, RegionLeft
from robrain.protocol.messages.motes.mote_messages import (
    MOTE_READING,
    ForwarderCount,
    GatewayCount,
    MoteFieldState,
    MoteReading,
)
from robrain.protocol.messages.tasks.mission_messages import MissionState, MissionStatus
from robrain.protocol.messages.tasks.rule_messages import RuleStatus
from robrain.protocol.messages.team.team_messages import TeamState
from robrain.protocol.model.geometry import Point2D
from tests.dashboard.test_panel_html import ATTRIBUTES, EVIL, TAGS, Page
from tests.dashboard.test_shown_team import tell

NOW_NS = to_ns(1000.0)
FIELD = MoteFieldState(
    motes=10, dead=1, delivery_ratio=0.97, age_s=5.0, oldest_s=140.0, coverage=0.7, on_duty=4,
    first_dead_ns=to_ns(700.0), forwarded=120, hops=1.5,
    forwarders=[ForwarderCount(mote=f"m{n}", readings=90 - n) for n in range(8)],
    gateways=[GatewayCount(name="m1", readings=300, waiting=40, dropped=3, last_seen_ns=to_ns(990.0))],
)  # fmt: skip


def view_of(
    field: MoteFieldState | None = None,
    rules: list[RuleStatus] | None = None,
    missions: list[MissionStatus] | None = None,
) -> ShownTeam:
    view = ShownTeam()
    state = TeamState(
        robots=[],
        mote_field=msgspec.UNSET if field is None else field,
        rules=msgspec.UNSET if rules is None else rules,
        missions=msgspec.UNSET if missions is None else missions,
    )
    view.team = msgspec.structs.replace(state, stamp_ns=NOW_NS)
    return view


def test_field_is_told_in_figures_with_its_forwarders_and_gateways() -> None:
    values = Page(field_html(view_of(FIELD))).values
    assert values["field-delivered"] == "97 %"
    assert (values["field-age"], values["field-oldest"]) == ("5 s", "2 min")
    assert (values["field-covered"], values["field-alive"], values["field-duty"]) == ("70 %", "9 of 10", "4 of 9")
    assert (values["field-first-dead"], values["field-half-dead"], values["field-last-dead"]) == ("5 min ago", "–", "–")
    assert values["field-forwarded"] == "120 readings, 1.5 times each; first by"
    assert "<b>m0</b> 90" in field_html(view_of(FIELD))
    assert "and 2 more" in field_html(view_of(FIELD))
    assert (values["gateway-m1-told"], values["gateway-m1-stores"], values["gateway-m1-dropped"]) == ("300", "40", "3")
    assert '<b class="rb-bad">3</b>' in field_html(view_of(FIELD))


def test_missions_are_listed_with_state_step_and_reason() -> None:
    assert missions_html(view_of()) == ""
    running = MissionStatus(id="m1", mission="round", state=MissionState.RUNNING, at=["gate", "look"])
    failed = MissionStatus(id="m2", mission="round", state=MissionState.FAILED, at=["gate"], why="step gate: a wall")
    html = missions_html(view_of(missions=[running, failed]))
    values = Page(html).values
    assert (values["mission-m1-state"], values["mission-m2-state"]) == ("running at gate, look", "failed at gate")
    assert values["mission-m2-why"] == "step gate: a wall"
    assert '<span class="rb-bad">failed</span>' in html


def test_names_from_the_wire_never_become_markup() -> None:
    field = msgspec.structs.replace(
        FIELD,
        forwarders=[ForwarderCount(mote=EVIL, readings=1)],
        gateways=[GatewayCount(name=EVIL, readings=1, waiting=1, dropped=1, last_seen_ns=0)],
    )
    mission = MissionStatus(id=EVIL, mission=EVIL, state=MissionState.FAILED, at=[EVIL], why=EVIL)
    view = view_of(field, [RuleStatus(name=EVIL, waits=EVIL, refused=1, why=EVIL)], [mission])
    tell(view, MOTE_READING, reading("m1", via=EVIL, hops=1, forwarder=EVIL), mote="m1")
    for html in (field_html(view), rules_html(view), missions_html(view), motes_html(view)):
        page = Page(html)
        assert page.tags <= TAGS
        assert page.attributes <= ATTRIBUTES


def reading(mote: str, x_m: float = 0.0, **way: Any) -> MoteReading:
    return MoteReading(
        mote=mote, place=Point2D(x_m, 0.0), quantity="temperature_c", value=20.0, voltage_v=2.9, rssi_dbm=-70.0,
        stamp_ns=to_ns(1.0), **({"via": "r1"} | way),
    )  # fmt: skip


def test_routes_lead_from_each_mote_to_the_one_that_passes_its_readings_on_and_to_gateways() -> None:
    view = ShownTeam()
    tell(view, MOTE_READING, reading("m1", 1.0, via="m1", waiting=0, dropped=0), mote="m1")
    tell(view, MOTE_READING, reading("m2", 2.0, via="m1", waiting=0, dropped=0), mote="m2")
    tell(view, MOTE_READING, reading("m3", 3.0, via="m1", hops=1, forwarder="m2", waiting=0, dropped=0), mote="m3")
    tell(view, MOTE_READING, reading("m4", 4.0), mote="m4")
    tell(view, MOTE_READING, reading("m5", 5.0, hops=1, forwarder="m9"), mote="m5")
    assert [(start.x_m, end.x_m) for start, end in mote_routes(view)] == [(2.0, 1.0), (3.0, 2.0)]
    tell(view, MOTE_READING, reading("m3", 3.0), mote="m3")  # a robot hears it now
    assert [(start.x_m, end.x_m) for start, end in mote_routes(view)] == [(2.0, 1.0)]


# -- what exploration has left -----------------------------------------------------------------------------------


REGION = RegionLeft(
    kind=LeftKind.TOO_NARROW, place=Point2D(9.1, 2.2), area_m2=5.0, low=Point2D(4.1, 1.4), high=Point2D(9.9, 3.1),
    gap_m=0.387, needed_m=0.44, gap_at=Point2D(3.9, 2.2),
)  # fmt: skip


def test_regions_are_listed_with_kind_place_area_and_reason() -> None:
    view = ShownTeam()
    tell(view, COORDINATOR_LEFT, ExplorationLeft(regions=[REGION], more=2, more_m2=1.5))
    values = Page(left_html(view)).values
    row = (values["left-1-kind"], values["left-1-place"], values["left-1-area"])
    assert row == ("too narrow", "9.1, 2.2", "5.0 m²")
    assert values["left-1-why"] == "the gap is 0.39 m wide (measured), robots need 0.44 m"
    assert values["left-more"] == "and 2 more, 1.5 m²"
