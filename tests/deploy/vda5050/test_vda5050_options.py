"""Options of `robrain vda5050`, and the bounded inbox of its link."""

from typing import Any, NamedTuple

import pytest

from robrain.deploy.errors import UsageError
from robrain.deploy.vda5050.messages import Version
from robrain.deploy.vda5050.mqtt_link import INBOX_CAPACITY, MESSAGE_MAX_BYTES, Broker, MqttLink, Packet
from robrain.deploy.vda5050.vda5050_commands import read_address
from robrain.protocol.clock import VirtualClock
from robrain.protocol.refusals import Refusals


def test_a_broker_is_host_and_port() -> None:
    assert Broker.read("10.0.0.5:1884") == ("10.0.0.5", 1884)
    assert Broker.read("broker") == ("broker", 1883)


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


class Arrived(NamedTuple):
    topic: str
    payload: bytes
    qos: int = 0
    retain: bool = False


def test_messages_without_room_and_too_large_ones_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("paho.mqtt.client.Client.loop_start", lambda _: None)
    refusals = Refusals(VirtualClock())
    link: Any = MqttLink(Broker("127.0.0.1", 1), "c", ["t"], refusals, Packet("will", b""))
    for number in range(INBOX_CAPACITY + 1):
        link._on_message(None, None, Arrived(f"t/{number}", b"{}"))
    link._on_message(None, None, Arrived("big", bytes(MESSAGE_MAX_BYTES + 1)))
    found = link.drain()
    assert (len(found), found[0].topic) == (INBOX_CAPACITY, "t/1")
    assert {(one.key, one.code, one.count) for one in refusals.counts()} == {
        ("t/0", "lost", 1),
        ("big", "too_large", 1),
    }
