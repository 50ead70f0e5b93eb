"""Patches that several of one process take into their maps: what a patch does to a submap is computed once.

A patch that is applied to the same cells gives the same cells, whoever applies it. Robots of one process hear the same
messages, in the order in which their sender sent them, so their copies of a mate's submap are the same arrays.
"""

import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.mapping.occupancy_grid import GridGeometry
from robrain.protocol.model.slam.submap import SubmapStep
from robrain.protocol.model.slam.submap_atlas import SubmapAtlas, SubmapKey
from robrain.protocol.wire.messages.map_messages import MapPatch


class _Kept:
    """What was computed from a patch last, and whose grid it was computed for."""

    def __init__(self, _patch: MapPatch) -> None:
        self.step: SubmapStep | None = None
        self.geometry: GridGeometry | None = None


def step_of(
    patch: MapPatch, atlas: SubmapAtlas, key: SubmapKey, cells: NDArray[np.int8], stamp_ms: int | NDArray[np.int32]
) -> SubmapStep:
    """What a patch with these cells makes of a submap of an atlas: computed once for all who hold the same of it."""
    kept, submap = patch.derived(_Kept), atlas.shaped(key)
    if kept.step is None or kept.step.before is not submap.evidence:
        kept.step, kept.geometry = submap.after(patch.row, patch.column, cells, stamp_ms), atlas.grid.geometry
    return kept.step


class SharedSteps:
    """Collects patches which others of the process have taken into the same cells, and has the atlas draw them at once.

    Args:
        atlas: that takes the patches.

    """

    def __init__(self, atlas: SubmapAtlas) -> None:
        self._atlas = atlas
        self._steps: list[tuple[SubmapKey, SubmapStep]] = []
        self._evidence: dict[SubmapKey, NDArray[np.int8]] = {}
        """What the submaps of these steps will hold."""

    def take(self, patch: MapPatch) -> bool:
        """Take a patch without parts as `take_message` would, if what it does to its submap has been computed already.

        That is so for cells of a known submap that has not moved, newer than what was known there, within its box.
        Others are left alone: `flush`, then `take_message`.
        """
        key, kept = (patch.robot, patch.submap), patch.derived(_Kept)
        step, submap, geometry = kept.step, self._atlas.submaps.get(key), self._atlas.grid.geometry
        if (
            step is None
            or submap is None
            or step.before is not self._evidence.get(key, submap.evidence)
            or not step.is_newest
            or step.evidence.size != submap.evidence.size
            or not (kept.geometry is geometry or kept.geometry == geometry)
            or patch.T_arena_local != submap.T_arena_local
            or patch.frame != submap.frame
            or patch.surfaces
        ):
            return False
        self._steps.append((key, step))
        self._evidence[key] = step.evidence
        return True

    def flush(self) -> None:
        """Have the atlas draw what was taken."""
        if self._steps:
            self._atlas.take_steps(self._steps)
            self._steps = []
            self._evidence.clear()
