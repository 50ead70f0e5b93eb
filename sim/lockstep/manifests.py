"""What a run's robots were made of, as text, for its recording."""

import msgspec

from robrain.agent.host.agent_host import stock_place
from robrain.agent.lifecycle.plugin_folders import PluginFolders
from robrain.protocol.wire.keys import DEFAULT_TEAM
from robrain.sim.world.world import World


def manifest_texts(world: World, team: str = DEFAULT_TEAM) -> dict[str, str]:
    """The robots' files and the manifests of the stock plugins, by a path for each."""
    texts = {
        f"robots/{robot.name}.toml": msgspec.toml.encode(world.robot_file(robot, team=team)).decode()
        for robot in world.robots
    }
    for name, path in PluginFolders([stock_place()]).find().items():
        texts[f"plugins/{name}.toml"] = path.read_text(encoding="utf-8")
    return texts
