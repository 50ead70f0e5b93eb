import math
from collections.abc import Iterator

import numpy as np
import pytest

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tinyos import READING_TYPE, ActiveMessage, ReadingPayload
from robrain.protocol.wire.clock import VirtualClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.session import open_lockstep_session
from robrain.protocol.wire.topics import ARENA_RADIO_RX
from robrain.sim.motes import ArenaMote, MoteField, TemperatureField
from robrain.sim.radio import RadioLink, RadioModel

TICK_S = 0.02
FIELD = TemperatureField(plume_at=Point2D(0.0, 0.0))
STEADY = RadioModel(shadowing_db=0.0, fading_db=0.0)


class Floor:
    """Motes, and what the base stations of robots at given places hear."""

    def __init__(self, endpoint: Endpoint) -> None:
        self.endpoint = endpoint
        self.inbox = Inbox(100_000)
        endpoint.subscribe(self.inbox, ARENA_RADIO_RX)

    def hear(
        self,
        motes: list[Point2D],
        robots: list[Point2D],
        *,
        seconds: float = 60.0,
        seed: int = 1,
        radio: RadioModel = STEADY,
    ) -> dict[str, list[ReadingPayload]]:
        names = [f"r{number}" for number in range(1, len(robots) + 1)]
        specs = [ArenaMote(name=f"m{number}", number=number, place=place) for number, place in enumerate(motes, 1)]
        field = MoteField(specs, names, FIELD, self.endpoint, np.random.default_rng(seed), TICK_S, radio)
        for _ in range(round(seconds / TICK_S)):
            field.step(robots)
        heard: dict[str, list[ReadingPayload]] = {name: [] for name in names}
        for received in self.inbox.drain():
            message = ActiveMessage.unpack(received.message)
            assert message.type == READING_TYPE
            heard[received.names["robot"]].append(ReadingPayload.unpack(message.payload))
        return heard


@pytest.fixture
def floor() -> Iterator[Floor]:
    session = open_lockstep_session()
    endpoint = Endpoint(session, "test", VirtualClock(), Drive.LOCKSTEP)
    yield Floor(endpoint)
    endpoint.close()
    session.close()


def test_a_mote_in_reach_is_heard_about_every_four_seconds(floor):
    heard = floor.hear([Point2D(0.0, 0.0)], [Point2D(5.0, 0.0)], seconds=400.0)["r1"]
    assert 98 <= len(heard) <= 101
    assert [reading.sequence for reading in heard] == list(range(len(heard)))


def test_motes_out_of_reach_are_not_heard(floor):
    heard = floor.hear([Point2D(0.0, 0.0), Point2D(20.0, 0.0)], [Point2D(5.0, 0.0), Point2D(50.0, 0.0)])
    assert {reading.mote for reading in heard["r1"]} == {1}
    assert heard["r2"] == []


def test_the_base_station_writes_how_strongly_it_heard(floor):
    heard = floor.hear([Point2D(0.0, 0.0)], [Point2D(1.0, 0.0), Point2D(5.0, 0.0)])
    assert {reading.rssi_dbm for reading in heard["r1"]} == {-60}
    assert {reading.rssi_dbm for reading in heard["r2"]} == {-81}


def test_a_reading_tells_place_and_temperature(floor):
    places = [Point2D(0.0, 0.0), Point2D(3.0, -1.5)]
    heard = floor.hear(places, [Point2D(1.0, 0.0)], seconds=200.0)["r1"]
    for number, place in enumerate(places, 1):
        readings = [reading for reading in heard if reading.mote == number]
        assert {(reading.x_dm, reading.y_dm) for reading in readings} == {
            (round(10 * place.x_m), round(10 * place.y_m))
        }
        mean_c = sum(reading.reading_centi for reading in readings) / len(readings) / 100
        assert mean_c == pytest.approx(FIELD.temperature_c(place), abs=0.06)


def test_motes_wake_apart_from_each_other_and_batteries_run_down(floor):
    heard = floor.hear([Point2D(0.0, 0.0), Point2D(1.0, 0.0)], [Point2D(2.0, 0.0)], seconds=20_000.0)["r1"]
    first, second = ([reading for reading in heard if reading.mote == number] for number in (1, 2))
    assert len({reading.voltage_mv for reading in (first[0], second[0])}) == 2
    for readings in (first, second):
        voltages = [reading.voltage_mv for reading in readings]
        assert voltages == sorted(voltages, reverse=True)
        assert 2100 < voltages[-1] <= voltages[0] <= 3100


def test_another_mote_or_robot_leaves_what_was_heard_as_it_was(floor):
    motes, robots = [Point2D(0.0, 0.0), Point2D(1.0, 0.0)], [Point2D(4.0, 0.0), Point2D(5.0, 0.0)]
    alone = floor.hear(motes[:1], robots[:1], radio=RadioModel())["r1"]
    with_mote = floor.hear(motes, robots[:1], radio=RadioModel())["r1"]
    with_robot = floor.hear(motes[:1], robots, radio=RadioModel())["r1"]
    assert alone
    assert [reading for reading in with_mote if reading.mote == 1] == alone
    assert with_robot == alone


def test_reach_is_about_ten_metres():
    assert RadioModel().reach_m == pytest.approx(10.0)
    assert RadioModel().mean_rssi_dbm(RadioModel().reach_m) == pytest.approx(-90.0)


def test_links_differ_by_their_shadowing_and_packets_by_their_fading():
    model = RadioModel(sensitivity_dbm=-1000.0)
    rngs = np.random.default_rng(3).spawn(400)
    links = [[RadioLink(model, rng)] for rng in rngs]
    strengths = np.array([[link[0].receive_dbm(10.0) for _ in range(20)] for link in links])
    assert strengths.mean() == pytest.approx(-90.0, abs=0.7)
    assert strengths.mean(axis=1).std() == pytest.approx(4.0, rel=0.15)
    assert strengths.std(axis=1).mean() == pytest.approx(1.0, rel=0.15)


def test_the_plume_is_warm_in_the_middle_and_fades():
    temperatures_c = [FIELD.temperature_c(Point2D(x_m, 0.0)) for x_m in (0.0, 1.0, 3.0, 9.0, 30.0)]
    assert temperatures_c[0] == 29.0
    assert temperatures_c == sorted(temperatures_c, reverse=True)
    assert math.isclose(temperatures_c[-1], 20.0)


@pytest.mark.parametrize("values", [{"exponent": 0.0}, {"shadowing_db": -1.0}, {"fading_db": float("nan")}])
def test_a_radio_model_without_sense_is_refused(values):
    with pytest.raises(ValueError, match="expected"):
        RadioModel(**values)
