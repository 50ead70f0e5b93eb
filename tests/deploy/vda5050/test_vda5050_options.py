"""Options of `robrain vda5050`, and the bounded inbox of its link."""

from pathlib import Path
from typing import Any, NamedTuple

import pytest

from robrain.deploy.errors import UsageError
from robrain.deploy.vda5050.messages import VehicleConnection, Version
from robrain.deploy.vda5050.mqtt_link import INBOX_CAPACITY, MESSAGE_MAX_BYTES, Broker, MqttLink
from robrain.deploy.vda5050.vda5050_commands import read_address
from robrain.protocol.clock import VirtualClock
from robrain.protocol.refusals import Refusals


def test_a_broker_is_host_and_port() -> None:
    assert Broker.read("10.0.0.5:1884")[:2] == ("10.0.0.5", 1884)
    assert Broker.read("broker")[:2] == ("broker", 1883)


def test_a_login_is_a_file_with_user_and_password(tmp_path: Path) -> None:
    (login := tmp_path / "login").write_text("ann:a:b\n")
    assert Broker.read("broker", login)[2:4] == ("ann", "a:b")
    login.write_text("ann")
    for file in (login, tmp_path / "none"):
        with pytest.raises(UsageError, match="--login"):
            Broker.read("broker", file)
    with pytest.raises(UsageError, match="--ca"):
        Broker.read("broker", None, login)


@pytest.mark.parametrize("text", ["", ":1883", "host:", "host:0", "host:65536", "host:mqtt"])
def test_another_broker_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="expected HOST:PORT"):
        Broker.read(text)


def test_a_vehicle_has_the_topics_of_its_version() -> None:
    topics = [read_address("acme/7", version, "", "0,0", 0.0).topic("order") for version in Version]
    assert topics == ["uagv/v2/acme/7/order", "vda5050/v3/acme/7/order"]


@pytest.mark.parametrize("text", ["acme", "acme/", "/7", "a+/7", "acme/7/8", "acme/#"])
def test_another_address_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="expected MANUFACTURER/SERIAL"):
        read_address(text, Version.V2_1, "", "0,0", 0.0)


class Wire(NamedTuple):
    clock: VirtualClock
    refusals: Refusals


class Arrived(NamedTuple):
    topic: str
    payload: bytes
    qos: int = 0
    retain: bool = False


def test_messages_without_room_and_too_large_or_malformed_ones_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("paho.mqtt.client.Client.loop_start", lambda _: None)
    wire: Any = Wire(VirtualClock(), Refusals(VirtualClock()))
    vehicle = read_address("acme/7", Version.V2_1, "", "0,0", 0.0)
    link: Any = MqttLink(vehicle, Broker("127.0.0.1", 1), "c", ["connection"], wire, ("connection", {}, 0))
    for number in range(INBOX_CAPACITY + 1):
        link._on_message(None, None, Arrived(f"t/{number}/connection", b'{"connectionState": "ONLINE"}'))
    link._on_message(None, None, Arrived("big", bytes(MESSAGE_MAX_BYTES + 1)))
    assert [message for message, _ in link.receive()] == [VehicleConnection("ONLINE")] * INBOX_CAPACITY
    link._on_message(None, None, Arrived("bad/connection", b"{}"))
    assert [str(message) for message, _ in link.receive()] == [
        "bad/connection: Object missing required field `connectionState`"
    ]
    assert {(one.key, one.code, one.count) for one in wire.refusals.counts()} == {
        ("t/0/connection", "lost", 1),
        ("big", "too_large", 1),
        ("bad/connection", "malformed", 1),
    }
