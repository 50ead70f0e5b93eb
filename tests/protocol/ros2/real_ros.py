"""Real ROS 2, where it is installed: what it serializes, and how it hashes types.

`python -m tests.protocol.ros2.real_ros` writes the golden file from it.
"""

import importlib.util
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from robrain.protocol.ros2.message_types import MessageType
from tests.protocol.ros2.sample_messages import NOT_IN_RCLPY, SERVICES, TYPES, sample, to_rclpy, without_padding

HERE = Path(__file__).parent
GOLDEN = HERE / "golden_ros2.json"
SEEDS = (1, 2)
ELSEWHERE = {
    "tf2_msgs": {"msg/TFMessage.msg": "geometry_msgs/TransformStamped[] transforms\n"},
    "robrain_msgs": {"srv/SubmitTask.srv": "string task\n---\nbool accepted\nstring answer\n"},
}
"""Definitions (of Jazzy) in packages that are not to be had without a ROS installation."""
SHARE = Path(sys.prefix) / "share"
HAS_RCLPY = importlib.util.find_spec("rclpy") is not None
NEEDED = "needs rclpy: pip install -c constraints.txt '.[dev]'"


def serialized(name: str, message: Any) -> bytes:
    """CDR of a message of rosbags' class, by rclpy and rmw_fastrtps."""
    from rclpy.serialization import serialize_message

    return bytes(serialize_message(to_rclpy(message, name)))


def golden_bytes(kind: MessageType[Any], message: Any) -> bytes:
    """As `serialized`, without what Fast CDR leaves between the fields."""
    return without_padding(serialized(kind.name, message), kind, message)


def described_hashes() -> dict[str, str]:
    """Hash of each type of the installed packages, as rosidl wrote it."""
    found: dict[str, str] = {}
    for path in SHARE.glob("*/*/*.json"):
        if path.parent.name in ("msg", "srv"):
            hashes = json.loads(path.read_text(encoding="utf-8"))["type_hashes"]
            found |= {each["type_name"]: each["hash_string"] for each in hashes}
    return found


def hashes_of(package: str, texts: dict[str, str], folder: Path) -> dict[str, str]:
    """Hashes that rosidl itself gives to definitions, by type.

    Args:
        package: name of their package.
        texts: definitions by file, such as `srv/SubmitTask.srv`.
        folder: for what rosidl writes.

    """
    from rosidl_adapter.msg import convert_msg_to_idl
    from rosidl_adapter.srv import convert_srv_to_idl
    from rosidl_generator_type_description import generate_type_hash

    converts = {"msg": convert_msg_to_idl, "srv": convert_srv_to_idl}
    for name, text in texts.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        converts[path.parent.name](folder, package, Path(name), path.parent)
    arguments = folder / "arguments.json"
    arguments.write_text(
        json.dumps(
            {
                "package_name": package,
                "output_dir": str(folder / "out"),
                "idl_tuples": [f"{folder}:{Path(name).with_suffix('.idl')}" for name in texts],
                "include_paths": [f"{path.name}:{path}" for path in SHARE.iterdir() if path.is_dir()],
            }
        )
    )
    generate_type_hash(str(arguments))
    found: dict[str, str] = {}
    for path in (folder / "out").glob("*/*.json"):
        found |= {each["type_name"]: each["hash_string"] for each in json.loads(path.read_text())["type_hashes"]}
    return found


def main() -> None:
    """Write the golden file."""
    hashes = described_hashes()
    for package, texts in ELSEWHERE.items():
        with tempfile.TemporaryDirectory() as folder:
            hashes |= hashes_of(package, texts, Path(folder))
    kinds = [kind for kind in TYPES if not kind.name.startswith(NOT_IN_RCLPY)]
    golden = {
        "hashes": {each.name: hashes[each.name] for each in (*TYPES, *SERVICES)},
        "cdr": {kind.name: [golden_bytes(kind, sample(kind, seed)).hex() for seed in SEEDS] for kind in kinds},
    }
    GOLDEN.write_text(json.dumps(golden, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
