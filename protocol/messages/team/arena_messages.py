"""Messages of a simulated world."""

from dataclasses import replace
from enum import StrEnum
from types import NoneType
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.messages.maps.map_messages import MapPatch
from robrain.protocol.messages.message import Message
from robrain.protocol.model.accuracy import MapAccuracy, PoseAccuracy
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.ranges import Count, Joules, Length, Metres, Name, Radians, Seconds, Share, Text
from robrain.protocol.topic import CAN_FRAME, PNG, SERIAL_BYTES, TINYOS_PACKET, Delivery, Query, Role, Topic, Urgency

Ranges = Annotated[list[Annotated[int, Meta(ge=0, le=10_000_000)]], Meta(max_length=100_000)]


class Scan(Message, frozen=True, kw_only=True):
    """One turn of a lidar. The sensor sits at the robot's centre."""

    robot: Name
    angle_min_rad: Radians
    """Bearing of the first beam, body frame."""
    angle_increment_rad: Radians
    """Angle from a beam to the next, counter-clockwise."""
    range_max_m: Length
    """Range of the lidar."""
    ranges_mm: Ranges
    """Millimetres; 0 is no return within `range_max_m`."""


class ArenaClock(Message, frozen=True, kw_only=True):
    """The arena's time."""

    sim_time_s: Seconds


class RobotTruth(msgspec.Struct, frozen=True, kw_only=True):
    """True pose of a simulated robot, and the accuracy of the poses that it has estimated up to now."""

    robot: Name
    pose: Pose2D
    collisions: Count
    """Collisions up to now."""
    distance_m: Metres
    """Path driven up to now."""
    energy_j: Joules
    accuracy: PoseAccuracy | None = None
    """Accuracy of its estimated poses up to now; null before the first."""


class MoteTruth(msgspec.Struct, frozen=True, kw_only=True):
    """True position of a simulated mote."""

    mote: Name
    place: Point2D


class BodyKind(StrEnum):
    """A moving object on a simulated floor that is no robot."""

    DOOR = "door"
    """A closed door."""
    MOVER = "mover"
    PERSON = "person"


class BodyTruth(msgspec.Struct, frozen=True, kw_only=True):
    """True pose of a closed door, a moving obstacle or a person."""

    body: Name
    """Its name, such as `person1`."""
    kind: BodyKind
    pose: Pose2D
    """Of its middle, arena frame; the yaw is the direction of its length."""
    length_m: Length
    """Extent along its yaw; the diameter of a disc."""
    width_m: Length
    """Extent across it."""
    is_round: bool = False
    """Whether it is a disc; a rectangle if not."""


class ArenaTruth(Message, frozen=True, kw_only=True):
    """The true state of the simulated world and the accuracy of the team's map, for referees and viewers only."""

    sim_time_s: Seconds
    robots: Annotated[list[RobotTruth], Meta(max_length=100_000)]
    motes: Annotated[list[MoteTruth], Meta(max_length=100_000)] = msgspec.field(default_factory=list)
    """Motes, one entry each."""
    explored_fraction: Share = 0.0
    """Share of the reachable floor that the team's maps know."""
    map_accuracy: MapAccuracy | None = None
    """Accuracy of the team's map; null if it was not judged yet."""
    bodies: Annotated[list[BodyTruth], Meta(max_length=100_000)] | msgspec.UnsetType = msgspec.UNSET
    """Closed doors, moving obstacles and people; absent on a floor without any."""


class LinkCounters(msgspec.Struct, kw_only=True):
    """Delivery of messages between radios: samples by receiver, requests and replies of queries."""

    delivered: Count = 0
    """Samples that have arrived or are in flight."""
    lost: Count = 0
    """Samples that got lost by chance."""
    crowded: Count = 0
    """Samples dropped because a radio had too much to send."""
    out_of_reach: Count = 0
    """Samples for receivers without a path to them."""
    overflowed: Count = 0
    """Samples and replies dropped because too many were in flight."""
    outdated: Count = 0
    """Samples of lossless topics that were never delivered: their sender had kept newer ones instead."""
    relayed: Count = 0
    """Samples, requests and replies that a radio has passed on for others."""
    asked: Count = 0
    """Requests."""
    timed_out: Count = 0
    """Requests and replies that were too late, or without a path."""


class RadioTruth(msgspec.Struct, frozen=True, kw_only=True):
    """One radio of the team."""

    party: Name
    """The robot, or `coordinator`."""
    place: Point2D
    receives: Annotated[list[Name], Meta(max_length=100_000)]
    """Parties that it receives without a relay."""
    hops: Count | None = None
    """Number of hops to the coordinator; null if there is no path."""


class ArenaLinks(Message, frozen=True, kw_only=True):
    """Radio neighbours on the team's simulated radio, for viewers only."""

    radios: Annotated[list[RadioTruth], Meta(max_length=100_000)]
    """The coordinator's, then the robots'."""
    counters: LinkCounters
    """Since the start of the run."""


class ArenaPreparation(Message, frozen=True, kw_only=True):
    """The arena before the first step of a lockstep run, while its navigation is compiled; for viewers only."""

    parts_ready: Count
    """Number of compiled parts."""
    parts: Count
    """Number of all parts."""
    remaining_s: Seconds | None = None
    """Estimated time until the run begins, wall clock; null if it is not known yet."""
    floor: MapPatch
    """The floor plan on the grid of the team's map: free and occupied cells. The robots do not know it."""
    truth: ArenaTruth
    """Robots and motes at their places."""


class OutsideInput(Message, frozen=True, kw_only=True):
    """An input of a lockstep run from another process that may have changed the run."""

    key: Text
    """Key that it came under, with `?by=NAME` behind it where a query named its caller."""
    payload: bytes
    """The payload, at most the first megabyte."""


class ScriptInput(OutsideInput, frozen=True, kw_only=True):
    """A request of the script that runs a team in lockstep, which may have changed the run."""


ARENA_CAN: Topic[bytes] = Topic(
    "arena/{robot}/can/{channel}",
    "A frame on a simulated robot's CAN bus; its nodes find each other by a query here, with empty replies",
    rate_hz=100, urgency=Urgency.INTERACTIVE_HIGH, encoding=CAN_FRAME, max_bytes=4096)  # fmt: skip
ARENA_RADIO_RX: Topic[bytes] = Topic(
    "arena/{robot}/radio/rx", "A TinyOS packet that the robot's base station receives", encoding=TINYOS_PACKET,
    max_bytes=4096)  # fmt: skip
ARENA_RADIO_TX: Topic[bytes] = Topic(
    "arena/{robot}/radio/tx", "A TinyOS packet that the robot's base station sends", role=Role.ROBOT,
    encoding=TINYOS_PACKET, max_bytes=4096)  # fmt: skip
ARENA_SERIAL: Topic[bytes] = Topic(
    "arena/{robot}/serial/{line}", "Bytes that a simulated robot's hardware sends on a serial line",
    encoding=SERIAL_BYTES, max_bytes=65_536)  # fmt: skip
ARENA_SERIAL_TX: Topic[bytes] = Topic(
    "arena/{robot}/serial/{line}/tx", "Bytes that a robot sends on a serial line of its simulated hardware",
    role=Role.ROBOT, encoding=SERIAL_BYTES, max_bytes=4096)  # fmt: skip
ARENA_SCAN = Topic(
    "arena/{robot}/scan", "One turn of a simulated lidar", Scan, rate_hz=5, delivery=Delivery.LATEST,
    recorded=True)  # fmt: skip
ARENA_CAMERA = Query(
    "arena/{robot}/camera", "Present picture of a simulated robot's camera: replies a PNG", NoneType, bytes,
    encoding=PNG, reads_only=True)  # fmt: skip
ARENA_SENSE = Query(
    "arena/{robot}/sense",
    "Present readings of the sensor board on a simulated robot: replies an object of numbers by reading", NoneType,
    dict[str, float], reads_only=True)  # fmt: skip
ARENA_CLOCK = Topic("arena/clock", "The arena's time", ArenaClock, rate_hz=10, delivery=Delivery.LATEST, max_bytes=4096)
ARENA_TRUTH = Topic(
    "arena/truth", "True poses, and the explored share", ArenaTruth, rate_hz=5, delivery=Delivery.LATEST, recorded=True,
    max_bytes=16_777_216)  # fmt: skip
ARENA_LINKS = Topic(
    "arena/links", "Links of the team's simulated radio", ArenaLinks, rate_hz=2, delivery=Delivery.LATEST,
    recorded=True, max_bytes=16_777_216)  # fmt: skip
ARENA_PREPARATION = Topic(
    "arena/preparation", "Floor plan and places before a lockstep run begins, while its navigation is compiled",
    ArenaPreparation, rate_hz=4, delivery=Delivery.LATEST, max_bytes=16_777_216)  # fmt: skip
ARENA_OUTSIDE = Topic(
    "arena/outside", "A query, frame or packet that reached a lockstep run from another process", OutsideInput,
    recorded=True, max_bytes=2_097_152)  # fmt: skip
ARENA_SCRIPT = replace(
    ARENA_OUTSIDE, pattern="arena/script", doc="A query of the script that runs a lockstep team",
    message=ScriptInput)  # fmt: skip
