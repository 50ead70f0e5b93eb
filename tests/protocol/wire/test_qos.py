"""Zenoh is told what the table says: halts before commands before states before other telemetry before maps."""

import zenoh

from robrain.protocol.links.zenoh_link import publisher_options
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP, ROBOT_MAP_WHOLE
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL, ROBOT_LOG
from robrain.protocol.messages.robots.robot_messages import ROBOT_IMAGE, ROBOT_PATH, ROBOT_STATE
from robrain.protocol.messages.tasks.offer_messages import ROBOT_OFFER
from robrain.protocol.messages.tasks.task_messages import TASK_SUBMIT
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE, HALT
from robrain.protocol.table.topics import all_rows
from robrain.protocol.topic import Topic, Urgency

CLASSES = (
    (HALT,),
    (ROBOT_CALL, ROBOT_OFFER, TASK_SUBMIT),
    (ROBOT_STATE, COORDINATOR_STATE),
    (ROBOT_PATH,),
    (ROBOT_MAP, ROBOT_LOG),
    (ROBOT_IMAGE, ROBOT_MAP_WHOLE),
)
"""Rows whose order matters most, most urgent first."""


def test_halts_go_before_commands_before_states_before_telemetry_before_maps_before_pictures():
    order = list(Urgency)
    ranks = [{order.index(row.urgency) for row in rows} for rows in CLASSES]
    assert ranks == [{number} for number in range(len(CLASSES))]


def test_only_halts_wait_for_room_and_everything_else_that_is_put_is_dropped_by_its_sender():
    waiting = [row.name for row in all_rows() if isinstance(row, Topic)
               and publisher_options(row)["congestion_control"] == zenoh.CongestionControl.BLOCK]  # fmt: skip
    assert waiting == ["halt"]
