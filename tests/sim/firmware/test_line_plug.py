"""A simulated robot's serial line as a pseudo terminal: bytes go both ways, and bursts are bounded."""

import os
from collections.abc import Callable
from pathlib import Path

from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.arena_messages import ARENA_SERIAL, ARENA_SERIAL_TX
from robrain.protocol.serial.serial_line import PortLine
from robrain.protocol.wire.endpoint import Endpoint
from robrain.sim.firmware.line_plug import LinePlug


def until(read: Callable[[], bytes], wanted: bytes) -> bytes:
    """What was read: the kernel passes bytes on when it likes."""
    found = b""
    for _ in range(10_000):
        found += read()
        if len(found) >= len(wanted):
            break
        os.sched_yield()
    return found


def test_bytes_go_both_ways_on_the_line_of_their_name(wire: Endpoint, tmp_path: Path) -> None:
    heard = Inbox()
    wire.subscribe(heard, ARENA_SERIAL_TX, robot="r1", line="base")
    plug = LinePlug(wire, "r1", "base", tmp_path / "r1-base")
    near = PortLine(str(plug.path), 57_600)
    wire.publisher(ARENA_SERIAL, robot="r1", line="base").put_bytes(b"12 13\r\n")
    wire.publisher(ARENA_SERIAL, robot="r1", line="lidar").put_bytes(b"not this")
    plug.step()
    assert until(near.read, b"12 13\r\n") == b"12 13\r\n"
    near.write(b"m 20 20\re\r")

    def sent() -> bytes:
        plug.step()
        return b"".join(data for _, _, data in heard.drain_raw())

    assert until(sent, b"m 20 20\re\r") == b"m 20 20\re\r"
    near.close()
    plug.close()
    assert not plug.path.exists()


def test_bytes_that_the_near_end_does_not_read_in_time_are_lost_and_counted(wire: Endpoint, tmp_path: Path) -> None:
    plug = LinePlug(wire, "r1", "lidar", tmp_path / "r1-lidar")
    sender = wire.publisher(ARENA_SERIAL, robot="r1", line="lidar")
    for _ in range(20):
        sender.put_bytes(bytes(10_000))
        plug.step()
    assert 100_000 < plug.lost_bytes <= 200_000
    plug.close()
