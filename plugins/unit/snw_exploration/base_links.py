"""Links by the motes' radio: what this robot says to be heard by other base stations, and whom it hears."""

from collections.abc import Iterable

from robrain.plugins.unit.snw_exploration.interface import HeardRobot
from robrain.plugins.unit.snw_exploration.mote_record import MoteRecord
from robrain.protocol.tinyos.packet import BadPacket
from robrain.protocol.tinyos.payloads import DECI, MAX_NAME_BYTES, SEQUENCES, BeaconPayload, sequences_after
from robrain.protocol.wire.clock import NS_PER_S
from robrain.protocol.wire.errors import BadName
from robrain.protocol.wire.keys import check_name
from robrain.protocol.wire.messages.robots.robot_messages import RadioLink, RobotLinks

MAX_ROBOTS = 256


class _Link:
    """One robot as this one hears it."""

    def __init__(self) -> None:
        self.sequence = -1
        self.packets = 0
        self.missed = 0
        self.sum_dbm = 0.0
        self.rssi_dbm = 0.0
        self.stamp_ns = 0


class BaseLinks:
    """The base stations that this one hears, and its own beacons.

    Args:
        robot: its own name.

    """

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self.has_mates = self._has_told = False
        self._sequence = 0
        self._links: dict[str, _Link] = {}

    def note_there(self, robot: str) -> None:
        """A robot of that name is in the team."""
        self.has_mates |= robot != self._robot

    def beacon(self) -> bytes | None:
        """The payload of its next beacon; None for a robot alone, whom nobody would hear, or with too long a name.

        A robot that has lost all others on the wire goes on: it is then that the radio counts.
        """
        if not self.has_mates or len(self._robot.encode()) > MAX_NAME_BYTES:
            return None
        self._sequence = (self._sequence + 1) % SEQUENCES
        return BeaconPayload(self._sequence, self._robot).pack()

    def hear(self, payload: bytes, stamp_ns: int) -> None:
        """A beacon has come.

        Raises:
            BadPacket: it is none, its name is no robot's, or it is one robot too many.

        """
        beacon = BeaconPayload.unpack(payload)
        link = self._links.get(beacon.robot)
        if link is None:
            link = self._links[self._new(beacon.robot)] = _Link()
        elif 0 < (gap := sequences_after(beacon.sequence, link.sequence)) < SEQUENCES // 4:  # else it started again
            link.missed += gap - 1
        link.sequence, link.stamp_ns, link.rssi_dbm = beacon.sequence, stamp_ns, float(beacon.rssi_dbm)
        link.packets += 1
        link.sum_dbm += beacon.rssi_dbm

    def heard(self) -> list[HeardRobot]:
        """The robots that were heard, by name."""
        return [
            HeardRobot(
                robot=name,
                rssi_dbm=link.rssi_dbm,
                mean_rssi_dbm=link.sum_dbm / link.packets,
                stamp_ns=link.stamp_ns,
                packets=link.packets,
                missed=link.missed,
            )
            for name, link in sorted(self._links.items())
        ]

    def message(self, now_ns: int, fresh_ns: int, motes: Iterable[MoteRecord]) -> RobotLinks | None:
        """Whom the robot hears, for the team; None if there has been nobody since the last one.

        Args:
            now_ns: by the robot's clock.
            fresh_ns: who was heard so long ago counts; a mote also within three of its periods.
            motes: those that are known.

        """
        links = [
            RadioLink(peer=name, is_robot=True, rssi_dbm=link.rssi_dbm, heard_ns=link.stamp_ns)
            for name, link in sorted(self._links.items())
            if now_ns - link.stamp_ns <= fresh_ns
        ]
        for mote in motes:
            heard = mote.latest
            if heard is None:
                continue
            age_ns = now_ns - mote.stamp_ns
            if age_ns <= fresh_ns or age_ns <= 3 * heard.period_ds * (NS_PER_S // DECI):
                links.append(RadioLink(peer=mote.name, rssi_dbm=float(heard.rssi_dbm), heard_ns=mote.stamp_ns))
        if not links and not self._has_told:
            return None
        self._has_told = bool(links)
        return RobotLinks(robot=self._robot, links=links)

    def _new(self, name: str) -> str:
        try:
            check_name("robot", name)
        except BadName as error:
            raise BadPacket(str(error)) from error
        if name == self._robot or len(self._links) >= MAX_ROBOTS:
            raise BadPacket(f"expected one of at most {MAX_ROBOTS} other robots, got {name!r}")
        return name
