"""A recording as one HTML page that plays it, without a server and without robrain: the dashboard's picture.

The page holds viser's own player (`get_scene_serializer`). Texts in the picture are drawn, never run.
"""

from collections.abc import Callable, Iterable
from pathlib import Path

from robrain.dashboard.layers.scene import Scene
from robrain.dashboard.server.server import close_server, open_server
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP
from robrain.recording.errors import check_absent, writing
from robrain.recording.reader.recorded_message import RecordedMessage, received, topic_named_by
from robrain.recording.replay.player import Player

FRAME_S = 0.1
FRAMES_MAX = 3000
"""A longer run has fewer frames a second: a browser holds all of them."""


def write_html(
    recording: Path, path: Path, on_progress: Callable[[float], None] | None = None, frames_max: int = FRAMES_MAX
) -> int:
    """Write a page that plays a recording; returns how many frames it has.

    Args:
        recording: an MCAP file.
        path: a file that does not exist yet.
        on_progress: called with the share that is done, 0 to 1.
        frames_max: maximum number of frames.

    Raises:
        RecordingError: the recording cannot be read, or the page exists or cannot be written.
    """
    check_absent(path)
    page, frames = _page(Player(recording), on_progress or (lambda _share: None), frames_max)
    with writing(path):
        path.write_text(page, encoding="utf-8")
    return frames


def _page(player: Player, show: Callable[[float], None], frames_max: int) -> tuple[str, int]:
    frame_s = max(FRAME_S, player.duration_s / frames_max)
    frames = max(int(player.duration_s / frame_s), 1)
    # The scene is made by a server without clients, on a port that is not published.
    server = open_server("127.0.0.1", 0)
    try:
        scene, view = Scene(server), ShownTeam()
        _frame(scene, player)
        serializer = server.get_scene_serializer()
        messages = player.seek(0.0)
        for frame in range(frames + 1):
            now_s = player.position_s
            _apply(messages, view, now_s)
            scene.draw(view, now_s)
            serializer.insert_sleep(frame_s)
            show(0.9 * frame / frames)
            messages = player.step_by(frame_s)
        page = serializer.as_html(dark_mode=True)
    finally:
        close_server(server)
    show(1.0)
    return page, frames + 1


def _frame(scene: Scene, player: Player) -> None:
    """Point the camera at the whole map, which the first frame does not have; viser's player does so only once."""
    end = ShownTeam()
    messages = player.seek(player.duration_s)
    _apply([message for message in messages if topic_named_by(message.topic_key) is ROBOT_MAP], end, player.duration_s)
    scene.draw(end, 0.0)
    scene.draw(ShownTeam(), 0.0)


def _apply(messages: Iterable[RecordedMessage], view: ShownTeam, now_s: float) -> None:
    for recorded in messages:
        known = received(recorded)
        if known is not None:
            view.apply(known, now_s)
