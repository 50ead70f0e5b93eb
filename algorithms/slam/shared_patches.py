"""Patches that several of one process take into their maps: what a patch does to a submap is computed once.

A patch that is applied to the same cells gives the same cells, whoever applies it. Robots of one process hear the same
messages, in the order in which their sender sent them, so their copies of a mate's submap are the same arrays.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.slam.submap import SubmapStep
from robrain.algorithms.slam.submap_atlas import SubmapAtlas, SubmapKey
from robrain.protocol.messages.maps.map_messages import MapPatch
from robrain.protocol.model.grid_geometry import GridGeometry

TOLD_SHARE = 0.75
"""Share of an atlas that messages may fill; the rest is reserved for the robot's own cells."""
STEPS_MAX = 8
"""What one patch does is kept for so many different cells of its submap."""


class _Kept:
    """What was computed from a patch."""

    def __init__(self, _patch: MapPatch) -> None:
        self.geometry: GridGeometry | None = None
        """The grid of those who have taken the patch; None as long as nobody has."""
        self.steps: dict[int, SubmapStep] = {}
        """By the `id` of the evidence before, which each step keeps alive: some may have missed an earlier patch."""


def step_of(
    patch: MapPatch, atlas: SubmapAtlas, key: SubmapKey, cells: NDArray[np.int8], stamp_ms: int | NDArray[np.int32]
) -> SubmapStep:
    """What a patch with these cells makes of a submap of an atlas: computed once for all who hold the same of it."""
    kept, submap = patch.derived(_Kept), atlas.shaped(key)
    step = kept.steps.get(id(submap.evidence))
    if step is None:
        step = _as_one_of(kept.steps.values(), submap.after(patch.row, patch.column, cells, stamp_ms))
        if len(kept.steps) < STEPS_MAX:
            kept.steps[id(submap.evidence)], kept.geometry = step, atlas.grid.geometry
    return step


def _as_one_of(steps: Iterable[SubmapStep], step: SubmapStep) -> SubmapStep:
    """The step; with the arrays of another one of the same patch if they are equal, so that the next is shared."""
    for other in steps:
        if (
            (other.row, other.column) == (step.row, step.column)
            and np.array_equal(other.evidence, step.evidence)
            and np.array_equal(other.stamp_ms, step.stamp_ms)
        ):
            return step._replace(evidence=other.evidence, stamp_ms=other.stamp_ms)
    return step


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
        self._more = 0
        """Bytes by which they grow."""

    def take(self, patch: MapPatch) -> bool:
        """Take a patch without parts as `merge_message` would, if what it does to its submap has been computed already.

        That is so for cells of a known submap that has not moved, newer than what was known there.
        Others are left alone: `flush`, then `merge_message`.
        """
        key, kept = (patch.robot, patch.submap), patch.derived(_Kept)
        submap, geometry = self._atlas.submaps.get(key), self._atlas.grid.geometry
        if submap is None or not kept.steps:
            return False
        step = kept.steps.get(id(self._evidence.get(key, submap.evidence)))
        if step is None:
            return False
        more = self._more + step.evidence.nbytes - step.before.nbytes
        if (
            not step.is_newest
            or (more and not self._atlas.has_room(more, TOLD_SHARE))
            or kept.geometry != geometry
            or patch.T_arena_local != submap.T_arena_local
            or patch.frame != submap.frame
            or patch.surfaces
        ):
            return False
        self._steps.append((key, step))
        self._evidence[key] = step.evidence
        self._more = more
        return True

    def flush(self) -> None:
        """Have the atlas draw what was taken."""
        if self._steps:
            self._atlas.apply_steps(self._steps)
            self._steps = []
            self._evidence.clear()
            self._more = 0
