"""The place of a run, for the judges of its invariants: walls and chargers, as far as a recording has them."""

import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from robrain.protocol.extras import missing_package
from robrain.protocol.model.geometry import Point2D
from robrain.recording.errors import RecordingError
from robrain.recording.invariants.invariant import UNKNOWN_SURROUNDINGS, FloorCharger, MissingEvidence, Surroundings
from robrain.recording.provenance import MAP_ATTACHMENT, MAP_YAML_ATTACHMENT, Provenance
from robrain.recording.reader.reading import read_provenance

if TYPE_CHECKING:  # recordings are checked without the simulator too
    from robrain.sim.maps.floor_plan import FloorPlan
    from robrain.sim.scenarios.scenario import Scenario


FAR_CELLS = 0.71
"""Half a cell's diagonal: so much less than that of its cell's middle a place's clearance can be."""
EXACT_UP_TO_M = 0.5
"""Beyond this a clearance is only reported as at least that of the cell (chosen: no hull of a robot is larger)."""


def surroundings_of(scenario: "Scenario") -> Surroundings:
    """Walls and chargers of a scenario.

    Raises:
        ScenarioError: its floor cannot be read.

    """
    return Surroundings(clearance_on(scenario.plan()), _chargers(scenario))


def clearance_on(plan: "FloorPlan") -> Callable[[float, float], float]:
    """A function that gives the distance in metres from a place (x, y), arena frame, to the nearest wall of a floor.

    It is 0 inside a wall and off the floor, and exact up to `EXACT_UP_TO_M`.
    """
    reach = int(np.ceil(EXACT_UP_TO_M / plan.resolution_m)) + 1
    width_m, height_m = plan.size_m

    def clearance(x_m: float, y_m: float) -> float:
        row, column = plan.cell_of(x_m, y_m)
        if not plan.holds_cell(row, column):
            return 0.0
        of_cell_m = float(plan.clearance_m[row, column]) - FAR_CELLS * plan.resolution_m
        if of_cell_m > EXACT_UP_TO_M:
            return of_cell_m
        x_m, y_m = x_m - plan.origin_x_m, y_m - plan.origin_y_m
        top, left = max(0, row - reach), max(0, column - reach)
        rows, columns = np.nonzero(plan.occupied[top : row + reach + 1, left : column + reach + 1])
        beyond_x_m = np.abs((columns + left + 0.5) * plan.resolution_m - x_m) - plan.resolution_m / 2
        beyond_y_m = np.abs((rows + top + 0.5) * plan.resolution_m - y_m) - plan.resolution_m / 2
        to_wall_m = np.hypot(np.maximum(beyond_x_m, 0.0), np.maximum(beyond_y_m, 0.0)).min(initial=np.inf)
        return min(float(to_wall_m), x_m, width_m - x_m, y_m, height_m - y_m)

    return clearance


def surroundings_of_recording(path: Path) -> Surroundings:
    """Walls and chargers of a recorded run; None if the file does not have them, or the simulator is not installed."""
    try:
        provenance = read_provenance(path)
    except RecordingError:  # it may be a recording of another system, and can be checked nevertheless
        return UNKNOWN_SURROUNDINGS
    with tempfile.TemporaryDirectory(prefix="robrain-check-") as folder:
        try:
            return surroundings_of_provenance(provenance, Path(folder))
        except ModuleNotFoundError as error:
            if missing_package(error) is None:
                raise
            return Surroundings(no_floor=MissingEvidence.SIMULATOR)


def surroundings_of_provenance(provenance: Provenance, folder: Path) -> Surroundings:
    """The same of a recorded run, as far as its file has it; its map file is written into a folder."""
    setup = provenance.setup
    toml = setup.toml if setup is not None else provenance.scenario_toml
    if not toml:
        return UNKNOWN_SURROUNDINGS
    from robrain.sim.errors import ScenarioError
    from robrain.sim.scenarios.scenario import Scenario

    if setup is not None and setup.map_yaml:
        (folder / MAP_YAML_ATTACHMENT).write_text(setup.map_yaml, encoding="utf-8")
        (folder / MAP_ATTACHMENT).write_bytes(provenance.map_png or b"")
    try:
        scenario = Scenario.from_toml(toml, base=folder)
    except ScenarioError:
        return UNKNOWN_SURROUNDINGS
    # A map file that is not in the recording may be another one by now, or another machine's.
    is_known = not isinstance(scenario.floor, Path) or scenario.floor == folder / MAP_YAML_ATTACHMENT
    with suppress(ScenarioError):
        if is_known:
            return surroundings_of(scenario)
    return Surroundings(chargers=_chargers(scenario))


def _chargers(scenario: "Scenario") -> tuple[FloorCharger, ...]:
    return tuple(FloorCharger(Point2D(*charger.place_m), charger.reach_m) for charger in scenario.chargers)
