from robrain.plugins.unit.snw_exploration.mote_record import MoteRecord, place_of
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.tinyos.payloads import NO_PLACE, Quantity, ReadingPayload, RequestPayload

HERE = Point2D(1.0, 2.0)


def reading(**changes):
    values = {
        "mote": 3, "sequence": 7, "oldest": 7, "period_ds": 40, "voltage_mv": 2900, "quantity": Quantity.TEMPERATURE,
        "value_centi": 2150, "x_dm": 50, "y_dm": -20, "rssi_dbm": -70,
    }  # fmt: skip
    return ReadingPayload(**values | changes)


def record():
    return MoteRecord("m3", 3, 64)


def test_row_of_a_mote_tells_its_last_packet_and_the_mean_of_all_strengths():
    one = record()
    one.record_packet(reading(rssi_dbm=-60), 1, None)
    one.record_packet(reading(sequence=8, rssi_dbm=-80, value_centi=2200), 2, HERE)
    row = one.as_received()
    assert (row.mote, row.place, row.heard_from) == ("m3", Point2D(5.0, -2.0), HERE)
    assert (row.rssi_dbm, row.mean_rssi_dbm, row.stamp_ns) == (-80, -70.0, 2)
    assert (row.period_s, row.voltage_v, row.last_value) == (4.0, 2.9, 22.0)
    assert (row.readings, row.missing) == (0, 0)


def test_stored_reading_is_not_the_last_value_unless_there_is_no_other():
    one = record()
    one.record_packet(reading(age_ds=1, value_centi=100), 1, None)
    assert (one.as_received().last_value, one.live_ns) == (1.0, 1)
    one.record_packet(reading(age_ds=0, value_centi=200), 2, None)
    one.record_packet(reading(age_ds=5, value_centi=300), 3, None)
    assert (one.as_received().last_value, one.live_ns, one.stamp_ns) == (2.0, 2, 3)


def test_request_is_answered_with_its_last_reading():
    one = record()
    one.record_answer(12)
    one.asked = RequestPayload(10, 0b111)
    one.record_answer(11)
    assert one.asked is not None
    one.record_answer(12)
    assert one.asked is None


def test_wish_counts_unless_a_later_one_is_known_and_is_tried_anew():
    one = record()
    assert one.want_period(40, 0)
    one.duty_tries = 5
    assert not one.want_period(50, -1)
    assert (one.wanted_period_ds, one.duty_tries) == (40, 5)
    assert one.want_period(60, 0)  # as late
    assert (one.wanted_period_ds, one.duty_tries) == (60, 0)


def test_only_a_mote_with_neither_coordinate_has_no_place():
    assert place_of(reading(x_dm=NO_PLACE, y_dm=NO_PLACE)) is None
    assert place_of(reading(x_dm=NO_PLACE, y_dm=10)) == Point2D(NO_PLACE / 10, 1.0)
