"""Robots that hear each other on the motes' radio, and what they tell the team of it."""

import numpy as np
import pytest

from robrain.plugins.unit.snw_exploration.snw_exploration import MAX_ROBOTS, BaseLinks
from robrain.protocol.messages.robots.robot_messages import ROBOT_LINKS
from robrain.protocol.messages.team.arena_messages import ARENA_RADIO_TX
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.tinyos.packet import ActiveMessage, BadPacket
from robrain.protocol.tinyos.payloads import BEACON_TYPE, SEQUENCES, BeaconPayload
from robrain.sim.motes.field import FieldSpec, SimulatedField
from robrain.sim.motes.mote import ArenaMote
from robrain.sim.motes.motes import MoteField, SensorNetwork
from robrain.sim.motes.radio import RadioModel

FAR = Point2D(500.0, 0.0)
RADIO = RadioModel(shadowing_db=0.0)


class Team:
    """Robots that stand where the test puts them, on one air with a mote at (2, 0)."""

    def __init__(self, one, robots=2, **parameters):
        self.one = one
        self.places = [FAR] * robots
        names = [f"r{number}" for number in range(1, robots + 1)]
        for name in names:
            one.host("snw_exploration", robot=name, snw_exploration=parameters)
        self.said = one.inbox(ARENA_RADIO_TX)
        self.links = one.inbox(ROBOT_LINKS)
        motes = [ArenaMote(name="m1", number=1, place=Point2D(2.0, 0.0))]
        field = SimulatedField(FieldSpec(), [], Point2D(0.0, 0.0), (10.0, 10.0))
        network = SensorNetwork(radio=RADIO)
        self._field = MoteField(motes, names, network, field, one.wire, np.random.default_rng(5), 0.02)

    def run(self, seconds):
        self.one.run(seconds, each=lambda: self._field.step(self.places))

    def beacons(self):
        messages = [ActiveMessage.unpack(received.message) for received in self.said.drain()]
        return [BeaconPayload.unpack(each.payload).robot for each in messages if each.type == BEACON_TYPE]

    def told(self, robot="r1"):
        """What a robot told last, and how often it told."""
        messages = [received.message for received in self.links.drain() if received.message.robot == robot]
        return (messages[-1].links if messages else None), len(messages)

    def heard(self, robot="r1"):
        return self.one.call("snw_exploration", "robots", robot=robot)


@pytest.fixture
def team(stage):
    return lambda **options: Team(stage(), **options)


def test_the_team_is_told_who_hears_whom_and_once_that_nobody_does(team):
    one = team(robots=2)
    one.places = [Point2D(0.0, 0.0), Point2D(4.0, 0.0)]
    one.run(12.0)
    links, count = one.told()
    assert [(link.peer, link.is_robot, round(link.rssi_dbm)) for link in links] == [
        ("r2", True, round(RADIO.mean_rssi_dbm_of(np.array([4.0]))[0])),
        ("m1", False, round(RADIO.mean_rssi_dbm_of(np.array([2.0]))[0])),
    ]
    assert 5 <= count <= 6  # each 2 s, from when anybody was heard
    one.places = [FAR, Point2D(4.0, 0.0)]
    one.run(6.5)
    assert [link.peer for link in one.told()[0]] == ["m1"]  # a mote speaks each 4 s
    one.run(10.0)
    assert one.told()[0] == []
    one.run(10.0)
    assert one.told() == (None, 0)


@pytest.mark.parametrize("payload", [b"", b"\x00\x01", b"\x00\x01a b\xb5", b"\x00\x01r1\xb5", b"\x00\x01\xff\xb5"])
def test_what_is_no_other_robot_s_beacon_is_counted_and_left(stage, payload):
    one = stage()
    one.host("snw_exploration")
    one.run(0.1)
    one.radio(ActiveMessage(type=BEACON_TYPE, payload=payload, source=0).pack())
    one.run(0.2)
    assert one.call("snw_exploration", "robots") == []
    assert one.call("snw_exploration", "counters")["unreadable"] == 1


def hearing(*sequences, robot="r2"):
    """What r1 knows of a robot whose beacons with these numbers it heard, a second apart."""
    links = BaseLinks("r1")
    for second, sequence in enumerate(sequences):
        payload = BeaconPayload(sequence % SEQUENCES, robot, -60 - 10 * second).pack()
        links.receive(payload, second)
    (heard,) = links.received()
    return heard


@pytest.mark.parametrize(
    ("sequences", "missed"),
    [
        ((7,), 0),  # the first one tells nothing of earlier ones
        ((7, 8, 9), 0),
        ((7, 9, 12), 3),
        ((SEQUENCES - 2, SEQUENCES + 1), 2),  # across the wrap
        ((7, 7), 0),  # the same again
        ((7, 3, 5), 1),  # it has started again
        ((0, SEQUENCES // 4 - 1), SEQUENCES // 4 - 2),
        ((0, SEQUENCES // 4), 0),  # so many were never missed: it has started again
        ((0, 20_000), 0),
    ],
)
def test_gap_in_the_numbers_counts_as_missed_unless_the_robot_has_begun_anew(sequences, missed):
    heard = hearing(*sequences)
    assert (heard.packets, heard.missed) == (len(sequences), missed)


def test_no_more_robots_are_heard_than_there_is_room_for():
    links = BaseLinks("r1")
    for number in range(MAX_ROBOTS):
        links.receive(BeaconPayload(1, f"other{number}").pack(), 0)
    with pytest.raises(BadPacket, match=f"at most {MAX_ROBOTS} other robots, got 'late'"):
        links.receive(BeaconPayload(1, "late").pack(), 0)
    links.receive(BeaconPayload(2, "other0").pack(), 0)
    assert len(links.received()) == MAX_ROBOTS
