"""Names, keys, quality of service, attachments and tokens, as rmw_zenoh writes them."""

import pytest

from robrain.protocol.ros2.errors import BadAttachment, BadRosName
from robrain.protocol.ros2.message_types import STRING
from robrain.protocol.ros2.qos import LATCHED, RELIABLE, SENSOR_DATA, Durability, History, Qos
from robrain.protocol.ros2.ros_names import check_domain, data_key, dds_type, full_name
from robrain.protocol.ros2.ros_node import Attachment, Entity, EntityKind, NodeId

CHATTER_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
"""Of std_msgs/msg/String in rmw_zenoh's design.md."""
CHATTER_KEY = f"0/chatter/std_msgs::msg::dds_::String_/{CHATTER_HASH}"
CHATTING = f"%chatter/std_msgs::msg::dds_::String_/{CHATTER_HASH}"
CHATTER_TOKEN = f"@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/{CHATTING}/::,7:,:,:,,"
TALKER = NodeId(2, "8b20917502ee955ac4476e0266340d5c", 0, "/", "talker")
LISTENER = NodeId(2, "aac3178e146ba6f1fc6e6a4085e77f21", 0, "/", "listener")
ADD = "example_interfaces/srv/AddTwoInts"
ADD_HASH = "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"
ADDING = f"%add_two_ints/example_interfaces::srv::dds_::AddTwoInts_/{ADD_HASH}/::,10:,:,:,,"
DOCUMENTED = [
    (
        "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener",
        Entity(EntityKind.NODE, LISTENER, 0),
    ),
    (
        f"@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MS/%/%/listener/{CHATTING}/::,10:,:,:,,",
        Entity(EntityKind.SUBSCRIPTION, LISTENER, 10, "/chatter", STRING.name, CHATTER_HASH, RELIABLE),
    ),
    (
        CHATTER_TOKEN,
        Entity(EntityKind.PUBLISHER, TALKER, 10, "/chatter", STRING.name, CHATTER_HASH, Qos(depth=7)),
    ),
    (
        f"@ros2_lv/2/f9980ee0495eaafb3e38f0d19e2eae12/0/10/SS/%/%/add_two_ints_server/{ADDING}",
        Entity(
            EntityKind.SERVER,
            NodeId(2, "f9980ee0495eaafb3e38f0d19e2eae12", 0, "/", "add_two_ints_server"),
            10,
            "/add_two_ints",
            ADD,
            ADD_HASH,
            RELIABLE,
        ),
    ),
]
"""Examples of rmw_zenoh's design.md."""


@pytest.mark.parametrize(
    ("name", "found"),
    [("scan", "/r1/scan"), ("a/b", "/r1/a/b"), ("/tf", "/tf"), ("~", "/r1/driver"), ("~/state", "/r1/driver/state")],
)
def test_a_name_is_completed_as_rcl_does(name, found):
    assert full_name(name, "/r1", "driver") == found


@pytest.mark.parametrize(
    "name", ["", "/", "/a/", "a//b", "1st", "/a/1st", "a b", "/a%b", "/*", "/a/**", "/ä", "x" * 300]
)
def test_a_name_against_the_rules_is_refused(name):
    with pytest.raises(BadRosName):
        full_name(name)


@pytest.mark.parametrize("domain", [-1, 233])
def test_a_domain_without_ports_is_refused(domain):
    with pytest.raises(BadRosName):
        check_domain(domain)


@pytest.mark.parametrize("name", ["Odometry", "nav_msgs/Odometry", "nav_msgs/msg/odometry", "a/msg/B/C", "a/msg/*"])
def test_a_type_against_the_rules_is_refused(name):
    with pytest.raises(BadRosName):
        dds_type(name)


@pytest.mark.parametrize(
    ("qos", "token"),
    [
        (RELIABLE, "::,10:,:,:,,"),
        (SENSOR_DATA, "2::,5:,:,:,,"),
        (LATCHED, ":1:,1:,:,:,,"),
        (Qos(durability=Durability.TRANSIENT_LOCAL, depth=100), ":1:,100:,:,:,,"),
        (Qos(depth=42), "::,:,:,:,,"),
        (Qos(history=History.KEEP_ALL), "::2,10:,:,:,,"),
    ],
)
def test_quality_of_service_is_said_as_rmw_zenoh_does(qos, token):
    assert qos.token == token


@pytest.mark.parametrize(("token", "entity"), DOCUMENTED, ids=lambda each: getattr(each, "kind", ""))
def test_a_token_is_that_of_rmw_zenoh(token, entity):
    assert entity.token == token


@pytest.mark.parametrize(
    ("domain", "name", "kind", "type_hash", "key"),
    [
        (0, "/chatter", STRING.name, STRING.type_hash, CHATTER_KEY),
        (0, "/robot1/chatter", STRING.name, STRING.type_hash, CHATTER_KEY.replace("0/", "0/robot1/", 1)),
        (2, "/add_two_ints", ADD, ADD_HASH, f"2/add_two_ints/example_interfaces::srv::dds_::AddTwoInts_/{ADD_HASH}"),
    ],
)
def test_a_key_is_that_of_rmw_zenoh(domain, name, kind, type_hash, key):
    assert data_key(domain, name, kind, type_hash) == key


def test_a_gid_is_the_hash_of_the_token():
    """XXH3 of 128 bits, low half first: pinned, since no rmw_zenoh is at hand."""
    assert dict(DOCUMENTED)[CHATTER_TOKEN].gid.hex() == "ac170f31eadcd9ff0cd86d7a17907d1c"


def test_an_attachment_is_33_bytes_as_zenoh_serializes_them():
    attachment = Attachment(2, 3, bytes(range(16)))
    expected = "0200000000000000" + "0300000000000000" + "10" + "000102030405060708090a0b0c0d0e0f"
    assert (attachment.pack().hex(), Attachment.unpack(bytes.fromhex(expected))) == (expected, attachment)


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        bytes(32),
        bytes(33),  # a gid of no bytes
        Attachment(-1, 0, bytes(16)).pack(),
        Attachment(0, -1, bytes(16)).pack(),
        Attachment(0, 0, bytes(16)).pack() + b"x",
    ],
)
def test_other_bytes_are_no_attachment(payload):
    with pytest.raises(BadAttachment):
        Attachment.unpack(payload)
