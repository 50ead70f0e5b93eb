"""The team's map of a recording as files of ROS's map_server: a picture and a YAML file beside it.

Cells are a byte each, as `map_saver` writes them: 254 free, 0 occupied, 205 unknown; the first row is the highest y.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from robrain.coordinator.recording.errors import RecordingError
from robrain.coordinator.recording.player import Player
from robrain.protocol.model.occupancy_grid import FREE, OCCUPIED, OccupancyGrid

FREE_BYTE, OCCUPIED_BYTE, UNKNOWN_BYTE = 254, 0, 205
OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196


def write_map(
    recording: Path, path: Path, at_s: float | None = None, on_progress: Callable[[float], None] | None = None
) -> list[Path]:
    """Write the map as the team knew it; returns the YAML file and the picture.

    Args:
        recording: an MCAP file.
        path: the YAML file, which does not exist yet; the picture has its name with `.pgm`.
        at_s: seconds since the first message; the end if None.
        on_progress: told the share that is done, 0 to 1.

    Raises:
        RecordingError: the recording cannot be read or knows no map at that time, the time is not in it, or a file
            exists or cannot be written; then none is left.
    """
    picture = path.with_suffix(".pgm")
    for each in (path, picture):
        if each.exists():
            raise RecordingError(each, f"{each} exists already: give another name or move it away")
    show = on_progress or (lambda _share: None)
    player = Player(recording)
    try:
        if at_s is not None and not 0.0 <= at_s <= player.duration_s:
            raise RecordingError(recording, f"--at {at_s:g}: expected 0 to {player.duration_s:.2f} s, as long as it is")
        grid = player.map_at(player.duration_s if at_s is None else at_s)
    finally:
        player.close()
    show(0.5)
    if grid is None or not grid.known_count:
        raise RecordingError(recording, f"{recording} has no map at that time")
    written: list[Path] = []
    try:
        for each, data in ((picture, _pgm(grid)), (path, _yaml(grid, picture.name).encode())):
            with each.open("xb") as file:
                written.append(each)
                file.write(data)
    except OSError as error:
        for each in written:
            each.unlink(missing_ok=True)
        raise RecordingError(path, f"cannot write {path}: {error.strerror or error}") from error
    show(1.0)
    return [path, picture]


def _pgm(grid: OccupancyGrid) -> bytes:
    classes = grid.classes()[::-1]
    cells = np.full(classes.shape, UNKNOWN_BYTE, np.uint8)
    cells[classes == FREE] = FREE_BYTE
    cells[classes == OCCUPIED] = OCCUPIED_BYTE
    return f"P5\n{grid.geometry.width} {grid.geometry.height}\n255\n".encode() + cells.tobytes()


def _yaml(grid: OccupancyGrid, picture: str) -> str:
    geometry = grid.geometry
    return (
        f"image: {picture}\nmode: trinary\nresolution: {geometry.resolution_m!r}\n"
        f"origin: [{geometry.origin_x_m!r}, {geometry.origin_y_m!r}, 0.0]\n"
        f"negate: 0\noccupied_thresh: {OCCUPIED_THRESH}\nfree_thresh: {FREE_THRESH}\n"
    )
