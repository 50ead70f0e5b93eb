"""A map as files of ROS's map_server: a picture and a YAML file beside it.

Cells are a byte each, as `map_saver` writes them: 254 free, 0 occupied, 205 unknown; the first row is the highest y.
"""

import math
from pathlib import Path

import numpy as np
import yaml

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED

FREE_BYTE, OCCUPIED_BYTE, UNKNOWN_BYTE = 254, 0, 205
OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196


def write_grid(grid: OccupancyGrid, path: Path) -> list[Path]:
    """Write a map; returns the YAML file and the picture.

    Args:
        grid: the map.
        path: the YAML file, which does not exist yet; the picture has its name with `.pgm`.

    Raises:
        OSError: a file exists or cannot be written; then none of the new files remains.

    """
    picture = path.with_suffix(".pgm")
    written: list[Path] = []
    try:
        for each, data in ((picture, _pgm(grid)), (path, _yaml(grid, picture.name).encode())):
            with each.open("xb") as file:
                written.append(each)
                file.write(data)
    except OSError:
        for each in written:
            each.unlink(missing_ok=True)
        raise
    return [path, picture]


def _pgm(grid: OccupancyGrid) -> bytes:
    classes = grid.classes()[::-1]
    cells = np.full(classes.shape, UNKNOWN_BYTE, np.uint8)
    cells[classes == FREE] = FREE_BYTE
    cells[classes == OCCUPIED] = OCCUPIED_BYTE
    return f"P5\n{grid.geometry.width} {grid.geometry.height}\n255\n".encode() + cells.tobytes()


def _yaml(grid: OccupancyGrid, picture: str) -> str:
    geometry = grid.geometry
    settings = {
        "image": picture,
        "mode": "trinary",
        "resolution": geometry.resolution_m,
        "origin": [geometry.origin_x_m, geometry.origin_y_m, 0.0],
        "negate": 0,
        "occupied_thresh": OCCUPIED_THRESH,
        "free_thresh": FREE_THRESH,
    }
    return yaml.safe_dump(settings, sort_keys=False, default_flow_style=None, width=math.inf)
