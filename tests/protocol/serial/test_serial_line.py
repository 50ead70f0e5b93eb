"""A serial port of this computer never blocks, even if its other end is not read."""

import os
import pty
import tty
from collections.abc import Iterator

import pytest

from robrain.protocol.serial.serial_line import PortLine


@pytest.fixture
def ends() -> Iterator[tuple[int, str]]:
    near, far = pty.openpty()
    tty.setraw(far)
    yield near, os.ttyname(far)
    os.close(near)
    os.close(far)


def test_what_a_full_line_does_not_take_is_dropped_at_once(ends: tuple[int, str]) -> None:
    near, name = ends
    line = PortLine(name, 57_600, has_dtr=False)
    assert line.write(b"m 1 1\r")
    taken = [line.write(b"x" * 1000) for _ in range(1000)]
    assert taken[0]
    assert not taken[-1]
    read = os.read(near, 6)
    assert read == b"m 1 1\r"
    line.close()


def test_a_line_that_is_lost_is_an_error(ends: tuple[int, str]) -> None:
    line = PortLine(ends[1], 57_600)
    line.close()
    with pytest.raises(OSError, match="not open"):
        line.write(b"x")
