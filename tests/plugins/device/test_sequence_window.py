from hypothesis import given
from hypothesis import strategies as st

from robrain.plugins.unit.snw_exploration.mote_record import SequenceWindow
from robrain.protocol.tinyos.payloads import SEQUENCES, SequenceRange


def window(*sequences, oldest=None, size=64):
    one = SequenceWindow(size)
    for sequence in sequences:
        one.add(sequence)
    if oldest is not None:
        one.mote_holds_from(oldest)
    return one


@given(
    st.integers(0, SEQUENCES - 1),
    st.lists(st.integers(0, 60), min_size=1, max_size=80),
    st.integers(0, 60),
    st.integers(1, 32),
)
def test_it_tells_what_a_set_would_tell(start, steps, oldest, span):
    one, have = SequenceWindow(64), set()
    for step in steps:
        assert one.add((start + step) % SEQUENCES, is_live=False) == (step not in have)
        have.add(step)
    newest = max(have)
    oldest = min(oldest, newest)
    one.mote_holds_from((start + oldest) % SEQUENCES)
    lacking = [step for step in range(oldest, newest + 1) if step not in have]
    assert one.missing == len(lacking)
    request = one.request(span)
    if not lacking:
        assert request is None
    else:
        wanted = [step for step in lacking if step < lacking[0] + span]
        assert request.sequences() == [(start + step) % SEQUENCES for step in wanted]
        for sequence in request.sequences():
            assert one.lacks(request)
            one.add(sequence, is_live=False)
        assert not one.lacks(request)


def test_live_reading_that_falls_back_by_sixteen_is_late_and_by_more_a_restart():
    late, restarted = window(100), window(100)
    assert late.add(84)
    assert late.missing == 15
    assert restarted.add(83)
    assert (restarted.missing, restarted.complete()) == (0, (SequenceRange(83, 83), 1))
