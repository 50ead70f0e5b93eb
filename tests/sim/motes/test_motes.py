import numpy as np
import pytest

from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.arena_messages import ARENA_RADIO_RX, ARENA_RADIO_TX
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.tinyos.packet import ActiveMessage
from robrain.protocol.tinyos.payloads import (
    ACKNOWLEDGE_TYPE,
    DUTY_TYPE,
    READING_TYPE,
    REQUEST_TYPE,
    STORED_TYPE,
    DutyPayload,
    Quantity,
    ReadingPayload,
    RequestPayload,
    SequenceRange,
)
from robrain.protocol.wire.endpoint import Endpoint
from robrain.sim.motes.field import FieldSpec, Levels, Plume, SimulatedField
from robrain.sim.motes.mote import ArenaMote, MoteSpec, ReadingLog
from robrain.sim.motes.motes import MoteField, SensorNetwork
from robrain.sim.motes.radio import AIRTIME_S, MoteState, RadioModel

TICK_S = 0.02
QUIET = Levels(base=20.0, plume=9.0, noise=0.0)
STEADY_RADIO = RadioModel(shadowing_db=0.0)
STEADY = SensorNetwork(
    motes=MoteSpec(jitter_s=0.0, drift_ppm=0.0), radio=STEADY_RADIO, field=FieldSpec(temperature=QUIET)
)
HERE = Point2D(0.0, 0.0)


class Floor:
    """Motes, and robots at given places that hear them and speak to them."""

    def __init__(
        self,
        endpoint: Endpoint,
        motes: list[Point2D],
        robots: list[Point2D],
        network: SensorNetwork = STEADY,
        seed: int = 1,
    ) -> None:
        self.robots = robots
        self.names = [f"r{number}" for number in range(1, len(robots) + 1)]
        self._inbox = Inbox(100_000)
        endpoint.subscribe(self._inbox, ARENA_RADIO_RX)
        self._senders = {name: endpoint.publisher(ARENA_RADIO_TX, robot=name) for name in self.names}
        specs = [ArenaMote(name=f"m{number}", number=number, place=place) for number, place in enumerate(motes, 1)]
        field = SimulatedField(network.field, [Plume(0.0, 0.0, 0.0, 0.0)], Point2D(-100.0, -100.0), (200.0, 200.0))
        rng = np.random.default_rng(seed)
        self.field = MoteField(specs, self.names, network, field, endpoint, rng, TICK_S)

    def run(self, seconds: float) -> dict[str, list[tuple[int, ReadingPayload]]]:
        """AM type and reading of each packet that each robot heard meanwhile."""
        for _ in range(round(seconds / TICK_S)):
            self.field.step(self.robots)
        heard: dict[str, list[tuple[int, ReadingPayload]]] = {name: [] for name in self.names}
        for received in self._inbox.drain():
            message = ActiveMessage.unpack(received.message)
            heard[received.names["robot"]].append((message.type, ReadingPayload.unpack(message.payload)))
        return heard

    def run_to_packet(self) -> ReadingPayload:
        """Until r1 hears one."""
        for _ in range(100_000):
            if heard := self.run(TICK_S)["r1"]:
                return heard[-1][1]
        raise AssertionError("nothing was ever heard")

    def say(
        self, kind: int, payload: RequestPayload | SequenceRange | DutyPayload | bytes, *, to: int = 1, by: str = "r1"
    ) -> None:
        raw = payload if isinstance(payload, bytes) else payload.pack()
        self._senders[by].put_bytes(ActiveMessage(type=kind, payload=raw, source=0, destination=to).pack())


def sensed(heard: list[tuple[int, ReadingPayload]], mote: int = 1) -> list[ReadingPayload]:
    return [reading for kind, reading in heard if kind == READING_TYPE and reading.mote == mote]


def stored(heard: list[tuple[int, ReadingPayload]]) -> list[int]:
    return [reading.sequence for kind, reading in heard if kind == STORED_TYPE]


# -- sensing and sending --------------------------------------------------------------------------------------


def test_a_mote_in_reach_is_heard_about_every_four_seconds(wire):
    network = SensorNetwork(radio=STEADY_RADIO)
    heard = sensed(Floor(wire, [HERE], [Point2D(5.0, 0.0)], network).run(400.0)["r1"])
    assert 98 <= len(heard) <= 101
    assert [reading.sequence for reading in heard] == list(range(len(heard)))


def test_the_base_station_writes_how_strongly_it_heard(wire):
    heard = Floor(wire, [HERE], [Point2D(1.0, 0.0), Point2D(5.0, 0.0)]).run(60.0)
    assert {reading.rssi_dbm for _, reading in heard["r1"]} == {-60}
    assert {reading.rssi_dbm for _, reading in heard["r2"]} == {-81}


def test_a_reading_tells_place_quantity_and_value(wire):
    network = SensorNetwork(
        motes=MoteSpec(quantities=("temperature", "humidity")),
        radio=STEADY_RADIO,
        field=FieldSpec(temperature=QUIET, humidity=Levels(base=40.0, plume=10.0, noise=0.0)),
    )
    heard = Floor(wire, [HERE, Point2D(3.0, -1.5)], [Point2D(1.0, 0.0)], network).run(10.0)["r1"]
    first, second = sensed(heard, 1)[0], sensed(heard, 2)[0]
    assert (first.x_dm, first.y_dm, first.quantity, first.value_centi) == (0, 0, Quantity.TEMPERATURE, 2900)
    assert (second.x_dm, second.y_dm, second.quantity) == (30, -15, Quantity.HUMIDITY)
    assert second.value_centi == round(100 * (40.0 + 10.0 * np.exp(-0.5 * (3.0**2 + 1.5**2) / 9.0)))


# -- the log --------------------------------------------------------------------------------------------------


def test_a_mote_that_is_met_late_gives_what_it_has_kept(wire):
    floor = Floor(wire, [HERE], [Point2D(50.0, 0.0)])
    floor.run(100.0)
    floor.robots = [Point2D(2.0, 0.0)]
    met = floor.run_to_packet()
    assert (met.oldest, met.sequence) == (0, 25)
    floor.say(REQUEST_TYPE, RequestPayload(3, 0b10111))
    heard = floor.run(1.0)["r1"]
    assert stored(heard) == [3, 4, 5, 7]
    ages_s = [reading.age_ds / 10 for kind, reading in heard if kind == STORED_TYPE]
    assert ages_s == pytest.approx([4.0 * (25 - number) for number in (3, 4, 5, 7)], abs=0.4)


def test_what_is_acknowledged_is_forgotten_and_the_rest_is_kept(wire):
    floor = Floor(wire, [HERE], [Point2D(2.0, 0.0)])
    floor.run(40.0)
    met = floor.run_to_packet()
    floor.say(ACKNOWLEDGE_TYPE, SequenceRange(0, met.sequence - 2))
    later = floor.run_to_packet()
    assert later.oldest == met.sequence - 1
    floor.say(REQUEST_TYPE, RequestPayload(0, 0xFFFFFFFF))
    assert stored(floor.run(1.0)["r1"]) == [met.sequence - 1, met.sequence, later.sequence]


def test_a_log_holds_what_was_added_until_it_is_forgotten():
    log = ReadingLog(4)
    assert log.oldest(0) == 0
    for number in range(6):
        log.add(number, 100 * number, float(number))
    assert [number in log for number in range(6)] == [False, False, True, True, True, True]
    assert log.get(4) == (400, 4.0)
    log.forget(2)
    log.forget(3)
    assert log.oldest(5) == 4
    with pytest.raises(KeyError):
        log.get(2)


# -- being spoken to ------------------------------------------------------------------------------------------


def test_a_duty_command_changes_the_period_and_is_confirmed_at_once(wire):
    floor = Floor(wire, [HERE], [Point2D(2.0, 0.0)])
    floor.run_to_packet()
    floor.say(DUTY_TYPE, DutyPayload.of_seconds(30.0))
    (kind, confirmed), *_ = floor.run(0.2)["r1"]
    assert (kind, confirmed.period_ds) == (STORED_TYPE, 300)
    assert len(sensed(floor.run(300.0)["r1"])) == 10


@pytest.mark.parametrize(
    ("kind", "payload"),
    [
        (REQUEST_TYPE, b"\x00"),  # too short
        (DUTY_TYPE, b"\x00\x00"),  # a period of 0
        (0x99, b"\x01\x02\x03"),  # another application's
    ],
)
def test_what_a_mote_does_not_understand_it_leaves_alone(wire, kind, payload):
    floor = Floor(wire, [HERE], [Point2D(2.0, 0.0)])
    floor.run_to_packet()
    floor.say(kind, payload)
    heard = floor.run(20.0)["r1"]
    assert len(sensed(heard)) == 5
    assert stored(heard) == []


@pytest.mark.parametrize("packet", [b"", b"\x00\x01", bytes(60)])
def test_bytes_that_are_no_packet_disturb_nobody(wire, packet):
    floor = Floor(wire, [HERE], [Point2D(2.0, 0.0)])
    wire.publisher(ARENA_RADIO_TX, robot="r1").put_bytes(packet)
    wire.publisher(ARENA_RADIO_TX, robot="stranger").put_bytes(packet)
    assert len(sensed(floor.run(40.0)["r1"])) == 10


# -- energy ---------------------------------------------------------------------------------------------------


def test_the_charge_used_is_the_time_in_each_state_times_its_current(wire):
    floor = Floor(wire, [HERE], [Point2D(2.0, 0.0)])
    floor.run(4000.0)
    battery = floor.field.motes[0].battery
    state_s = battery.state_s
    rounds = round(state_s[MoteState.SEND] / AIRTIME_S)
    assert rounds == 1000
    assert state_s[MoteState.LISTEN] == pytest.approx(0.2 * rounds, rel=0.01)
    assert sum(state_s.values()) == pytest.approx(4000.0, abs=4.0)
    fresh = Floor(wire, [HERE], [Point2D(2.0, 0.0)]).field.motes[0].battery
    used_share = fresh.left_share - battery.left_share
    expected_mas = (
        0.1 * state_s[MoteState.SLEEP]
        + 8.7 * state_s[MoteState.SENSE]
        + 26.4 * state_s[MoteState.LOG]
        + (8.0 + 4.65) * state_s[MoteState.SEND]
        + (4.13 + 7.96) * state_s[MoteState.LISTEN]
    )
    assert 3600 * MoteSpec().capacity_mah * used_share == pytest.approx(expected_mas)


def test_a_mote_whose_batteries_are_flat_falls_silent(wire):
    network = SensorNetwork(motes=MoteSpec(capacity_mah=0.5, used_at_start_max=0.0), radio=STEADY_RADIO)
    floor = Floor(wire, [HERE], [Point2D(2.0, 0.0)], network)
    voltages = [reading.voltage_mv for reading in sensed(floor.run(6000.0)["r1"])]
    assert voltages == sorted(voltages, reverse=True)
    assert 2100 <= voltages[-1] < voltages[0] <= 3100
    assert floor.run(60.0)["r1"] == []
