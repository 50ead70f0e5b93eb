"""Addresses of a live arena's Serial Forwarders: printed, read by the parent process, noted in robot files."""

from collections.abc import Iterable, Mapping
from contextlib import ExitStack

from robrain.protocol.wire.endpoint import Endpoint
from robrain.sim.motes.serial_forwarder import SerialForwarder

_SAID = "serial forwarder of "


def open_forwarders(endpoint: Endpoint, robots: Iterable[str], closing: ExitStack) -> list[SerialForwarder]:
    """Open one per robot, each on a free port of loopback, closed with `closing`."""
    forwarders = []
    for robot in robots:
        forwarder = SerialForwarder(endpoint, robot)
        closing.callback(forwarder.close)
        forwarders.append(forwarder)
    return forwarders


def addresses(forwarders: Iterable[SerialForwarder]) -> dict[str, str]:
    """`host:port` of each robot's forwarder."""
    return {forwarder.robot: "{}:{}".format(*forwarder.address) for forwarder in forwarders}


def said(robot: str, address: str) -> str:
    """The line of output with a forwarder's address.

    >>> said("r1", "127.0.0.1:9002")
    'serial forwarder of r1: 127.0.0.1:9002'
    """
    return f"{_SAID}{robot}: {address}"


def read_said(lines: Iterable[str]) -> dict[str, str]:
    """Parse the addresses from lines of output.

    >>> read_said(["arena: depot", "serial forwarder of r1: 127.0.0.1:9002"])
    {'r1': '127.0.0.1:9002'}
    """
    told = (line.removeprefix(_SAID).partition(": ") for line in lines if line.startswith(_SAID))
    return {robot: address for robot, _, address in told}


def note(robot: str, forwarders: Mapping[str, str]) -> str:
    """A comment for the robot's file; empty if it has no forwarder."""
    if robot not in forwarders:
        return ""
    host, _, port = forwarders[robot].partition(":")
    return (
        f"# While this arena runs, a Serial Forwarder of the robot's base station is at {host}:{port}. To go by it:\n"
        f'# [parameters.mote_base]\n# interface = "sf"\n# host = "{host}"\n# port = {port}\n\n'
    )
