"""The place of a run, for the judges of its invariants: walls and chargers, as far as a recording has them."""

import tempfile
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from robrain.protocol.extras import missing_package
from robrain.protocol.model.geometry import Point2D
from robrain.recording.errors import RecordingError
from robrain.recording.invariants.invariant import UNKNOWN_SURROUNDINGS, FloorCharger, MissingEvidence, Surroundings
from robrain.recording.provenance import MAP_ATTACHMENT, MAP_YAML_ATTACHMENT, Provenance
from robrain.recording.reader.reading import read_provenance

if TYPE_CHECKING:  # recordings are checked without the simulator too
    from robrain.sim.scenarios.scenario import Scenario


EXACT_UP_TO_M = 0.5
"""Beyond this a clearance is only reported as at least that of the cell (chosen: no hull of a robot is larger)."""


def surroundings_of(scenario: "Scenario") -> Surroundings:
    """Walls and chargers of a scenario.

    Raises:
        ScenarioError: its floor cannot be read.

    """
    plan = scenario.plan()
    return Surroundings(lambda x_m, y_m: plan.wall_distance_m(x_m, y_m, EXACT_UP_TO_M), _chargers(scenario))


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
