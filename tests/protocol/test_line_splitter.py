import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.line_splitter import LineSplitter

LINES = st.lists(st.binary(max_size=9).map(lambda line: line.replace(b"\n", b"").replace(b"\r", b"")), max_size=6)


@given(LINES, st.sampled_from([b"\n", b"\r\n"]), st.integers(1, 7))
def test_lines_are_the_same_however_their_bytes_arrive_and_long_ones_are_marked(
    lines: list[bytes], ending: bytes, size: int
) -> None:
    splitter, found = LineSplitter(5), []
    stream = b"".join(line + ending for line in lines) + b"rest"
    for begin in range(0, len(stream), size):
        found += splitter.feed(stream[begin : begin + size])
        assert len(splitter._begun) <= 6
    assert found == [line if len(line) <= 5 else None for line in lines]
    assert splitter.has_begun


@pytest.mark.parametrize(("skips_first", "found"), [(True, [b"two"]), (False, [b"ne", b"two"])])
def test_the_first_line_may_have_begun_earlier(skips_first: bool, found: list[bytes]) -> None:
    splitter = LineSplitter(9, skips_first=skips_first)
    assert splitter.feed(b"ne\ntwo\n") == found
    assert not splitter.has_begun
