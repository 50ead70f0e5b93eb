from collections.abc import Iterator

import can
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from robrain.protocol.can.frames import codec
from robrain.protocol.can.zenoh_bus import ZenohBus
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.firmware.battery import BatteryManager, BatterySpec, Gauge, GaugeSpec, SimulatedBattery, open_circuit_v
from robrain.sim.firmware.power_model import PowerModel

TICK_S = 0.02
EXACT = GaugeSpec(
    voltage_noise_v=0.0,
    voltage_offset_v=0.0,
    voltage_step_v=0.0,
    current_noise_a=0.0,
    current_offset_a=0.0,
    current_gain=0.0,
    current_step_a=0.0,
    temperature_noise_c=0.0,
)


def drain(power_w: float, **spec: float) -> SimulatedBattery:
    """A battery that this load has emptied."""
    battery = SimulatedBattery(BatterySpec(**spec))
    while not battery.is_cut_off:
        battery.step(power_w, 0.0, 1.0)
    return battery


def run(battery: SimulatedBattery, load_w: float, supply_w: float, duration_s: float) -> None:
    for _ in range(round(duration_s)):
        battery.step(load_w, supply_w, 1.0)


# -- the battery ------------------------------------------------------------------------------------------------


def test_a_battery_delivers_no_more_than_its_capacity_and_most_of_it():
    battery = drain(10.0, capacity_wh=20.0)
    assert 0.9 * 20.0 * 3600.0 < battery.delivered_j < 20.0 * 3600.0
    assert battery.temperature_c > 22.0


def test_the_higher_the_load_the_less_energy_is_found():
    found_j = [drain(power_w, capacity_wh=20.0).delivered_j for power_w in (5.0, 15.0, 30.0, 60.0)]
    assert found_j == sorted(found_j, reverse=True)
    assert found_j[-1] < 0.95 * found_j[0]


def test_an_old_battery_delivers_less_and_sags_more():
    young, old = (drain(15.0, capacity_fade=fade, resistance_growth=2.5 * fade) for fade in (0.0, 0.2))
    assert 0.75 < old.delivered_j / young.delivered_j < 0.8
    sag_v = []
    for growth in (0.0, 0.5):
        battery = SimulatedBattery(BatterySpec(resistance_growth=growth))
        battery.step(30.0, 0.0, 0.2)
        sag_v.append(open_circuit_v(1.0) - battery.voltage_v)
    assert sag_v[1] == pytest.approx(1.5 * sag_v[0], rel=0.02)


def test_the_voltage_relaxes_after_a_load_and_the_bound_charge_comes_back():
    battery = SimulatedBattery(BatterySpec())
    run(battery, 40.0, 0.0, 600.0)
    loaded_v = battery.voltage_v
    battery.step(0.0, 0.0, 0.2)
    at_once_v = battery.voltage_v
    run(battery, 0.0, 0.0, 100.0)
    relaxed_v = battery.voltage_v
    run(battery, 0.0, 0.0, 1500.0)
    assert loaded_v < at_once_v < relaxed_v < battery.voltage_v


def test_a_battery_below_its_voltage_cuts_off_under_load_and_holds_it():
    battery = drain(15.0)
    assert battery.voltage_v < 12.0
    run(battery, 15.0, 0.0, 60.0)
    assert battery.voltage_v > 12.1  # it has recovered, and gives nothing all the same
    assert (battery.is_cut_off, battery.current_a) == (True, 0.0)


def test_an_empty_battery_gives_power_again_once_it_is_charged():
    battery = drain(15.0)
    run(battery, 8.0, 40.0, 30.0)
    assert battery.is_cut_off
    run(battery, 8.0, 40.0, 300.0)
    assert not battery.is_cut_off


def test_charging_is_by_constant_current_then_by_constant_voltage_and_ends():
    battery = SimulatedBattery(BatterySpec(soc_at_start=0.5))
    currents_a, voltages_v = [], []
    for _ in range(7200):
        battery.step(0.0, 40.0, 1.0)
        currents_a.append(battery.current_a)
        voltages_v.append(battery.voltage_v)
    assert currents_a[60] == -1.5
    assert max(voltages_v) < 16.42
    tapering = [-current_a for current_a in currents_a if -1.5 < current_a < 0.0]
    assert tapering[len(tapering) // 2] < tapering[0]
    assert currents_a[-1] == 0.0
    assert 0.97 < battery.soc <= 1.0


def test_a_charger_feeds_the_load_first():
    battery = SimulatedBattery(BatterySpec(soc_at_start=0.5))
    battery.step(10.0, 18.0, 1.0)
    assert -battery.current_a * battery.voltage_v == pytest.approx(8.0)
    battery.step(10.0, 4.0, 1.0)
    assert battery.current_a * battery.voltage_v == pytest.approx(6.0)
    assert battery.delivered_j == pytest.approx(20.0)


@settings(max_examples=50, deadline=None)
@example([(0.0, 21.0, 30.0)], 0.9375)
@given(
    st.lists(st.tuples(st.floats(0.0, 200.0), st.floats(0.0, 100.0), st.floats(0.02, 30.0)), max_size=60),
    st.floats(0.0, 1.0),
)
def test_no_history_takes_charge_out_of_nowhere_or_makes_nonsense(steps, soc):
    battery = SimulatedBattery(BatterySpec(capacity_wh=1.0, soc_at_start=soc))
    before_j = 0.0
    for load_w, supply_w, duration_s in steps:
        battery.step(load_w, supply_w, duration_s)
        assert 0.0 <= battery.soc <= 1.0 + 1e-9
        assert 0.0 < battery.voltage_v < 20.0
        assert battery.delivered_j >= before_j
        before_j = battery.delivered_j


# -- the manager ------------------------------------------------------------------------------------------------


@pytest.fixture
def buses() -> Iterator[tuple[can.BusABC, can.BusABC]]:
    session = open_lockstep_session()
    board = ZenohBus("r1/can0", session=session, direct=True)
    host = ZenohBus("r1/can0", session=session, direct=True)
    yield board, host
    host.shutdown()
    board.shutdown()
    session.close()


def heard(host: can.BusABC) -> list[dict[str, float]]:
    return [codec("BatteryStatus").unpack(frame) for frame in iter(lambda: host.recv(timeout=0), None)]


def manager(board: can.BusABC, gauge: GaugeSpec = EXACT, **spec: float) -> BatteryManager:
    battery = SimulatedBattery(BatterySpec(gauge=gauge, **spec))
    return BatteryManager(board, battery, PowerModel(), TICK_S, np.random.default_rng(1))


def test_the_manager_reports_what_standing_and_motion_cost(buses):
    board, host = buses
    one = manager(board)
    assert one.period_ticks == 10
    for motion_j in (0.0, 0.8):
        one.measure(motion_j)
    standing, moving = (reading["voltage_v"] * reading["current_a"] for reading in heard(host))
    assert standing == pytest.approx(8.0, rel=1e-2)
    assert moving == pytest.approx(8.0 + 0.8 / 0.2, rel=1e-2)


def test_a_gauge_that_lies_tells_what_it_was_made_to(buses):
    board, host = buses
    one = manager(board)
    one.lie = lambda reading: (9.0, *reading[1:])
    one.measure(0.0)
    assert heard(host)[-1]["voltage_v"] == 9.0


def test_a_gauge_is_off_by_what_its_spec_says():
    gauges = [Gauge(GaugeSpec(), np.random.default_rng(seed)) for seed in range(200)]
    readings = np.array([[gauge.read(15.0, 1.0, 20.0) for _ in range(50)] for gauge in gauges])
    offsets_v, offsets_a = readings[:, :, 0].mean(axis=1) - 15.0, readings[:, :, 1].mean(axis=1) - 1.0
    assert np.std(offsets_v) == pytest.approx(0.005, rel=0.2)
    assert np.std(offsets_a) == pytest.approx(np.hypot(0.003, 0.005), rel=0.2)
    assert np.std(readings[0, :, 0]) == pytest.approx(0.008, rel=0.4)
    steps = readings[:, :, 0] / 0.004
    assert np.allclose(steps, np.round(steps), atol=1e-6)


# -- the load ---------------------------------------------------------------------------------------------------


def test_power_grows_with_speed_and_payload():
    power = PowerModel()
    assert power.motion_w(0.0, 0.0, 4.0) == 0.0
    assert power.motion_w(-0.4, 0.0, 4.0) == power.motion_w(0.4, 0.0, 4.0) > power.motion_w(0.2, 0.0, 4.0)
    assert power.motion_w(0.0, 1.0, 4.0) > 0.0
    loaded = PowerModel(payload_kg=4.0)
    assert loaded.motion_w(0.4, 0.0, 4.0) == pytest.approx(0.3 + 2.0 * 7.5 * 0.4)
