"""How the process of an arena tells where the Serial Forwarders of robots' base stations listen."""

from collections.abc import Iterable

_SAID = "serial forwarder of "


def said(robot: str, address: str) -> str:
    """The line of output that tells of one.

    >>> said("r1", "127.0.0.1:9002")
    'serial forwarder of r1: 127.0.0.1:9002'
    """
    return f"{_SAID}{robot}: {address}"


def read_addresses(lines: Iterable[str]) -> dict[str, str]:
    """The addresses that lines of output tell of.

    >>> read_addresses(["arena: depot", "serial forwarder of r1: 127.0.0.1:9002"])
    {'r1': '127.0.0.1:9002'}
    """
    told = (line.removeprefix(_SAID).partition(": ") for line in lines if line.startswith(_SAID))
    return {robot: address for robot, _, address in told}
