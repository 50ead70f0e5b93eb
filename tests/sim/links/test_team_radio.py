"""Who hears whom on a floor, by which hops, and what a message costs."""

import numpy as np
import pytest

from robrain.protocol.clock import to_ns, to_seconds
from robrain.sim.maps.drawing import FloorDrawing, Wall, rasterise
from robrain.sim.world.link_spec import LinkSpec, PartitionSpec
from robrain.sim.world.team_radio import TeamRadio, walls_between

CHAIN = {"r1": (5.0, 5.0), "r2": (14.0, 5.0), "r3": (23.0, 5.0), "r4": (32.0, 5.0)}


def floor(*walls):
    drawn = tuple(Wall(from_m=(x_m, 0.0), to_m=(x_m, 10.0)) for x_m in walls)
    return rasterise(FloorDrawing(size_m=(40.0, 10.0), resolution_m=0.1, walls=drawn), "hall")


def radio(places=CHAIN, *, walls=(), seed=1, now_s=0.0, off=(), **spec):
    made = TeamRadio(LinkSpec(**spec), floor(*walls), list(places), np.array(list(places.values())), seed)
    made.update(to_ns(now_s), [party for party in made.parties if party not in off])
    return made


def took_s(network, hearer, *, size=100, now_s=0.0, source="r1"):
    """How long a sample takes; None if it does not arrive."""
    took_ns = network.spread(source, [hearer], size, to_ns(now_s))
    return to_seconds(took_ns[hearer]) if hearer in took_ns else None


def test_radios_hear_each_other_up_to_the_range():
    near, far = {"r1": (5.0, 5.0), "r2": (15.0, 5.0)}, {"r1": (5.0, 5.0), "r2": (15.01, 5.0)}
    assert radio(near, range_m=10.0).reaches("r1", "r2")
    assert not radio(far, range_m=10.0).reaches("r1", "r2")


def test_a_way_leads_over_as_few_relays_as_possible():
    network = radio(range_m=10.0)
    assert [network.hops("r1", name) for name in ("coordinator", "r1", "r2", "r3", "r4")] == [1, 0, 1, 2, 3]
    assert radio(range_m=20.0).hops("r1", "r4") == 2


def test_nobody_is_reached_over_who_does_not_relay():
    assert not radio(range_m=10.0, relays=False).reaches("r1", "r3")
    assert radio(range_m=10.0, relays=("r2",)).reaches("r1", "r3")
    assert not radio(range_m=10.0, relays=("r2",)).reaches("r1", "r4")
    assert not radio(range_m=10.0, off=("r2",)).reaches("r1", "r3")


def test_coordinator_stands_where_the_first_robot_starts_unless_it_has_a_place():
    assert radio().places_m["coordinator"] == (5.0, 5.0)
    network = radio(range_m=10.0, relays=False, coordinator_m=(32.0, 6.0))
    assert network.neighbours("coordinator") == ["r3", "r4"]


@pytest.mark.parametrize(
    ("from_m", "to_m", "walls"),
    [
        ((5.0, 5.0), (9.0, 5.0), 0),
        ((5.0, 5.0), (15.0, 5.0), 1),
        ((15.0, 5.0), (5.0, 5.0), 1),
        ((5.0, 1.0), (25.0, 9.0), 2),
        ((-5.0, 5.0), (5.0, 5.0), 1),  # the floor's own edge
        ((5.0, 5.0), (5.0, 5.0), 0),
    ],
)
def test_walls_on_a_line_are_counted_once_each(from_m, to_m, walls):
    assert walls_between(floor(10.0, 20.0), from_m, to_m) == walls


def test_walls_shorten_the_range():
    places = {"r1": (8.0, 5.0), "r2": (14.0, 5.0)}
    assert radio(places, walls=(10.0,), range_m=10.0).reaches("r1", "r2")
    assert radio(places, walls=(10.0,), range_m=10.0, wall_db=6.0).reaches("r1", "r2")  # 6.3 m are left
    assert not radio(places, walls=(10.0,), range_m=10.0, wall_db=7.0).reaches("r1", "r2")  # 5.8 m
    assert not radio(places, walls=(10.0, 12.0), range_m=10.0, wall_db=6.0).reaches("r1", "r2")
    assert not radio(places, walls=(10.0,), walls_block=True).reaches("r1", "r2")
    assert radio(places, walls=(20.0,), walls_block=True).reaches("r1", "r2")


def test_each_hop_takes_its_delay_and_its_time_of_sending():
    network = radio(range_m=10.0, delay_s=0.05, bandwidth_bytes_s=1000.0)
    assert took_s(network, "r4") == pytest.approx(3 * (0.05 + 0.1))


def test_a_radio_sends_one_message_after_the_other_and_drops_those_that_would_wait_too_long():
    network = radio(bandwidth_bytes_s=1000.0, queue_s=0.25)
    assert [took_s(network, "r2") for _ in range(4)] == pytest.approx([0.1, 0.2, 0.3, None])
    assert network.counters.crowded == 1
    assert took_s(network, "r2", now_s=0.3) == pytest.approx(0.1)


def test_a_relay_sends_what_others_say_besides_its_own():
    network = radio(range_m=10.0, bandwidth_bytes_s=1000.0)
    assert took_s(network, "r3", source="r1") == pytest.approx(0.2)
    assert took_s(network, "r1", source="r2") == pytest.approx(0.2)
    assert network.counters.relayed == 1


def test_a_sample_for_many_is_sent_once_by_each_hop_of_their_tree():
    network = radio(range_m=10.0, bandwidth_bytes_s=1000.0)
    took_ns = network.spread("r1", ["r2", "r3", "r4"], 100, 0)
    assert [to_seconds(took_ns[name]) for name in ("r2", "r3", "r4")] == pytest.approx([0.1, 0.2, 0.3])
    assert network.counters.relayed == 2


def test_losses_are_as_frequent_as_they_are_to_be_on_each_hop():
    network = radio(range_m=10.0, loss=0.2)
    one = sum(took_s(network, "r2") is not None for _ in range(2000))
    three = sum(took_s(network, "r4") is not None for _ in range(2000))
    assert one / 2000 == pytest.approx(0.8, abs=0.03)
    assert three / 2000 == pytest.approx(0.8**3, abs=0.04)
    assert network.counters.lost == 4000 - one - three


def test_a_request_is_sent_again_until_it_arrives_or_is_too_late():
    network = radio(loss=0.5)
    took = [network.carry("r1", "r2", 100, 0, to_ns(2.0)) for _ in range(400)]
    assert None not in took
    assert {0, to_ns(0.1), to_ns(0.2)} < set(took)
    late = [network.carry("r1", "r2", 100, 0, to_ns(0.05)) for _ in range(400)]
    assert sum(each is None for each in late) == pytest.approx(200, abs=50)


def test_a_request_takes_its_hops_and_none_where_there_is_no_way():
    network = radio(range_m=10.0, delay_s=0.1, off=("r4",))
    assert network.carry("r1", "r3", 10, 0, to_ns(1.0)) == to_ns(0.2)
    assert network.carry("r1", "r3", 10, 0, to_ns(0.15)) is None
    assert network.carry("r1", "r4", 10, 0, to_ns(1.0)) is None


def test_a_partition_is_in_force_from_its_begin_until_its_end():
    cut = PartitionSpec(from_s=1.0, until_s=2.0, groups=(("r3", "r4"),))
    heard = {}
    network = radio(partitions=(cut,))
    for now_s in (0.9, 1.0, 1.9, 2.0):
        network.update(to_ns(now_s), list(network.parties))
        heard[now_s] = network.reaches("r1", "r3"), network.reaches("r3", "r4"), network.reaches("r1", "coordinator")
    assert heard == {0.9: (True,) * 3, 1.0: (False, True, True), 1.9: (False, True, True), 2.0: (True,) * 3}


def test_who_hears_whom_follows_the_robots():
    network = radio(range_m=10.0)
    network.where = lambda: np.array([(5.0, 5.0), (14.0, 5.0), (23.0, 5.0), (24.0, 5.0)])
    assert network.hops("r1", "r4") == 3
    network.update(to_ns(0.02), list(network.parties))
    assert network.hops("r1", "r4") == 3  # measured ten times a second
    network.update(to_ns(0.1), list(network.parties))
    assert network.hops("r2", "r4") == 1
