"""The known floor at one moment, as a plan takes it."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # brings the map's kernels, which a coordinator loads when it is up (coordinator/live.py)
    from robrain.protocol.model.mapping.occupancy_grid import GridGeometry


class Floor(NamedTuple):
    """What is known of the floor at one moment."""

    classes: NDArray[np.int8]
    geometry: "GridGeometry"
    version: int
