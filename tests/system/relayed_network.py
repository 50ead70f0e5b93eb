"""A second host: a network namespace joined to this machine by a link whose loss, delay and cuts a test decides.

The link is two TUN devices, one at each end, and a thread that carries packets from one to the other. It does what
`tc netem` does (https://man7.org/linux/man-pages/man8/tc-netem.8.html), by seed, and in kernels that lack that module.
"""

import fcntl
import heapq
import os
import random
import select
import struct
import subprocess
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from shutil import which

import pytest

NEAR, FAR = "10.213.78.1", "10.213.78.2"
"""Addresses of this machine and of the other host, on the link."""
TUNSETIFF, IFF_TUN, IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
PACKET_BYTES = 65536
QUEUE_MAX = 1000
"""Packets on their way, as in netem; more are lost."""


class RelayedNetwork:
    """A network namespace whose processes reach this machine at `NEAR`, and it them at `FAR`."""

    def __init__(self) -> None:
        self.loss = 0.0
        """Share of packets lost, in each direction."""
        self.delay_s = 0.0
        """In each direction."""
        self.is_cut = False
        self.carried = self.lost = 0
        self._random = random.Random(20)
        self._name = f"robrain{os.getpid()}t"
        self._ends: list[int] = []
        self._stop_read, self._stop_write = os.pipe()
        self._thread = threading.Thread(target=self._carry, daemon=True)
        why = _why_not()
        if why:
            pytest.skip(f"no second host here: {why}")
        near, far = f"rtn{os.getpid()}", f"rtf{os.getpid()}"
        try:
            _ip("netns", "add", self._name)
            self._ends = [_tun(near), _tun(far)]
            _ip("link", "set", far, "netns", self._name)
            _ip("address", "add", f"{NEAR}/30", "dev", near)
            _ip("link", "set", near, "up")
            _ip("-n", self._name, "address", "add", f"{FAR}/30", "dev", far)
            _ip("-n", self._name, "link", "set", "lo", "up")
            _ip("-n", self._name, "link", "set", far, "up")
        except (OSError, subprocess.CalledProcessError) as error:
            self.close()
            pytest.skip(f"no second host here: {getattr(error, 'stderr', '') or error}")
        self._thread.start()

    def words(self, command: Sequence[str]) -> list[str]:
        """The command that runs `command` on the other host."""
        return ["ip", "netns", "exec", self._name, *command]

    def close(self) -> None:
        """Remove host and link."""
        os.write(self._stop_write, b"x")
        if self._thread.is_alive():
            self._thread.join()
        for descriptor in (*self._ends, self._stop_read, self._stop_write):
            os.close(descriptor)
        subprocess.run(["ip", "netns", "delete", self._name], capture_output=True, check=False)

    def _carry(self) -> None:
        """Carry packets until `close`; each is lost or waits by itself."""
        waiting: list[tuple[float, int, int, bytes]] = []
        number = 0
        while True:
            left_s = max(0.0, waiting[0][0] - time.monotonic()) if waiting else None
            ready, _, _ = select.select([*self._ends, self._stop_read], [], [], left_s)
            if self._stop_read in ready:
                return
            for end in self._ends:
                if end not in ready:
                    continue
                packet = os.read(end, PACKET_BYTES)
                if self.is_cut or self._random.random() < self.loss or len(waiting) >= QUEUE_MAX:
                    self.lost += 1
                    continue
                number += 1
                other = self._ends[1] if end == self._ends[0] else self._ends[0]
                heapq.heappush(waiting, (time.monotonic() + self.delay_s, number, other, packet))
            while waiting and waiting[0][0] <= time.monotonic():
                _, _, other, packet = heapq.heappop(waiting)
                if not self.is_cut:
                    self.carried += 1
                    os.write(other, packet)


@contextmanager
def relayed_network() -> Iterator[RelayedNetwork]:
    """A second host for the duration of the block; skips the test, with the reason, where there can be none."""
    network = RelayedNetwork()
    try:
        yield network
    finally:
        network.close()


def _tun(name: str) -> int:
    descriptor = os.open("/dev/net/tun", os.O_RDWR)
    fcntl.ioctl(descriptor, TUNSETIFF, struct.pack("16sH22x", name.encode(), IFF_TUN | IFF_NO_PI))
    return descriptor


def _why_not() -> str:
    if which("ip") is None:
        return "there is no command `ip`"
    if not os.path.exists("/dev/net/tun"):
        return "the kernel has no TUN devices"
    return "" if os.geteuid() == 0 else "only root may make network namespaces"


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], capture_output=True, text=True, check=True)
