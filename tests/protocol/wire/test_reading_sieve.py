"""Which readings of motes are new, however many robots bring them in."""

from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.border.reading_sieve import ReadingSieve
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.motes.mote_messages import MoteReading


def reading(sequence, *, mote="m1", via="r1", taken_s=100.0, told_s=None, quantity="temperature_c"):
    stamp_ns = to_ns(taken_s if told_s is None else told_s)
    return MoteReading(
        mote=mote, place=None, quantity=quantity, value=20.0, voltage_v=3.0, rssi_dbm=-70.0, via=via,
        sequence=sequence, measured_ns=to_ns(taken_s), stamp_ns=stamp_ns,
    )  # fmt: skip


def test_a_stored_reading_of_yesterday_that_two_robots_fetch_an_hour_apart_is_new_once():
    sieve = ReadingSieve()
    day_s, drift = 86_400.0, 1e-4
    assert sieve.is_new(reading(7, taken_s=100.0, told_s=day_s))
    assert not sieve.is_new(reading(7, via="r2", taken_s=100.0 - drift * day_s, told_s=day_s + 3600.0))


def test_a_number_that_comes_round_or_a_mote_that_starts_anew_is_a_new_reading():
    sieve = ReadingSieve()
    assert sieve.is_new(reading(7, taken_s=100.0))
    assert sieve.is_new(reading(7, taken_s=100.0 + 60.0))
    assert not sieve.is_new(reading(7, via="r2", taken_s=100.0 + 60.0))


def test_readings_without_a_number_are_never_taken_for_repeated():
    sieve = ReadingSieve()
    assert sieve.is_new(reading(None))
    assert sieve.is_new(reading(None))


def test_no_more_readings_are_remembered_than_may_be():
    sieve = ReadingSieve(capacity=3)
    for sequence in range(4):
        sieve.is_new(reading(sequence))
    assert sieve.is_new(reading(0))
    assert not sieve.is_new(reading(3))


@given(st.permutations([(sequence, via) for sequence in range(8) for via in ("r1", "r2", "r3")]))
def test_in_whatever_order_robots_tell_each_reading_is_new_once(told):
    sieve = ReadingSieve()
    new = [sequence for sequence, via in told if sieve.is_new(reading(sequence, via=via, taken_s=4.0 * sequence + 1.0))]
    assert sorted(new) == list(range(8))
