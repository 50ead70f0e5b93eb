"""A network of its own for one process, joined to this machine by a cable (veth) that a test can cut."""

import os
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from shutil import which

import pytest

NEAR, FAR = "10.213.77.1", "10.213.77.2"
"""Addresses of this machine and of the other network, on the cable."""


class CutNetwork:
    """A network namespace whose processes reach this machine at `NEAR`."""

    def __init__(self) -> None:
        self._name = f"robrain{os.getpid()}"
        self._near, self._far = f"rbn{os.getpid()}", f"rbf{os.getpid()}"
        why = _why_not()
        if why:
            pytest.skip(f"no network namespaces here: {why}")
        try:
            _ip("netns", "add", self._name)
            _ip("link", "add", self._near, "type", "veth", "peer", "name", self._far, "netns", self._name)
            _ip("address", "add", f"{NEAR}/30", "dev", self._near)
            _ip("-n", self._name, "address", "add", f"{FAR}/30", "dev", self._far)
            _ip("-n", self._name, "link", "set", "lo", "up")
            _ip("-n", self._name, "link", "set", self._far, "up")
            self.join()
        except subprocess.CalledProcessError as error:
            self.close()
            pytest.skip(f"no network namespaces here: {error.stderr.strip()}")

    def words(self, command: Sequence[str]) -> list[str]:
        """The command that runs `command` in the other network."""
        return ["ip", "netns", "exec", self._name, *command]

    def cut(self) -> None:
        """Let nothing pass any more; neither end is told."""
        _ip("link", "set", self._near, "down")

    def join(self) -> None:
        """Let everything pass again."""
        _ip("link", "set", self._near, "up")

    def close(self) -> None:
        """Remove network and cable."""
        subprocess.run(["ip", "netns", "delete", self._name], capture_output=True, check=False)
        subprocess.run(["ip", "link", "delete", self._near], capture_output=True, check=False)


@contextmanager
def cut_network() -> Iterator[CutNetwork]:
    """A network for the duration of the block; skips the test, with the reason, where there can be none."""
    network = CutNetwork()
    try:
        yield network
    finally:
        network.close()


def _why_not() -> str:
    if which("ip") is None:
        return "there is no command `ip`"
    return "" if os.geteuid() == 0 else "only root may make them"


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], capture_output=True, text=True, check=True)
