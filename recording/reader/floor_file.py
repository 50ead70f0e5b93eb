"""A floor that is known before the run, from a map of ROS's map_server or from the recording of an earlier run."""

from pathlib import Path

import numpy as np

from robrain.algorithms.slam.floor_map import FloorMap, floor_of_atlas, floor_of_cells
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry
from robrain.recording.drawing.drawn_map import ComposedMap
from robrain.recording.errors import MapError
from robrain.recording.reader.map_server import read_occupancy
from robrain.recording.reader.reading import read_messages
from robrain.recording.reader.recorded_message import topic_named_by

RECORDING = ".mcap"


def read_floor(path: Path) -> FloorMap:
    """The floor of a map_server YAML file, or the last map of the team in a recording.

    Raises:
        MapError: the file has no map, or no free space; the text names it.
        RecordingError: the recording cannot be read.

    """
    floor = _of_recording(path) if path.suffix == RECORDING else _of_map_server(path)
    if not (floor.classes == FREE).any():
        raise MapError(f"{path}: expected a map with free space, found none")
    return floor


def _of_map_server(path: Path) -> FloorMap:
    percent, settings = read_occupancy(path)
    classes = np.select([percent == 0, percent == 100], [FREE, OCCUPIED], UNKNOWN).astype(np.int8)
    height, width = classes.shape
    origin_x_m, origin_y_m, _ = settings.origin
    return floor_of_cells(GridGeometry(settings.resolution, origin_x_m, origin_y_m, width, height), classes)


def _of_recording(path: Path) -> FloorMap:
    known = ComposedMap()
    for message in read_messages(path):
        if topic_named_by(message.topic_key) is ROBOT_MAP:
            known.handle(message.payload)
    if known.atlas is None:
        raise MapError(f"{path}: expected the recording of a run with a map, found no map in it")
    return floor_of_atlas(known.atlas)
