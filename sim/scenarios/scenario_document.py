"""A scenario as the document that a scenario TOML holds, with every default written out."""

from pathlib import Path
from typing import Any

import msgspec

from robrain.sim.maps.drawing import FloorDrawing
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.scenarios.scenario_file import MapTable, MotesTable, ScenarioTable, ScenarioTables, TeamTable


def scenario_document(scenario: Scenario) -> dict[str, Any]:
    """The tables of a scenario as dictionaries, lists and plain values; None stands for an absent key.

    The path of a map is absolute, so the document does not depend on a folder.
    """
    near = scenario.near
    motes = {name: getattr(scenario.network.motes, name) for name in scenario.network.motes.__struct_fields__}
    tables = ScenarioTables(
        scenario=ScenarioTable(
            name=scenario.name,
            about=scenario.about,
            seed=scenario.seed,
            until_explored=scenario.until_explored,
            time_limit_s=scenario.time_limit_s,
        ),
        floor=scenario.floor if isinstance(scenario.floor, FloorDrawing) else None,
        map=MapTable(str(scenario.floor.resolve())) if isinstance(scenario.floor, Path) else None,
        team=TeamTable(
            robots=scenario.robots,
            near_m=(near.x_m, near.y_m) if near is not None else None,
            starts=scenario.starts,
            starts_known=scenario.starts_known,
        ),
        motes=MotesTable(**motes, count=scenario.motes, places_m=scenario.mote_places[: scenario.motes]),
        radio=scenario.network.radio,
        field=scenario.network.field,
        robot=scenario.hardware,
        chargers=scenario.chargers,
        planning=scenario.planning,
        faults=scenario.faults,
        surfaces=scenario.surfaces,
        disturbance=scenario.disturbance,
        tasks=scenario.tasks,
        robots=scenario.roster,
        doors=scenario.traffic.doors,
        movers=scenario.traffic.movers,
        people=scenario.traffic.people,
    )
    found = msgspec.to_builtins(tables)
    assert isinstance(found, dict)
    return found


def document_toml(document: dict[str, Any]) -> str:
    """The TOML text of a document; keys that are None are left out."""
    return msgspec.toml.encode(_without_none(document)).decode()


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    if isinstance(value, (list, tuple)):
        return [_without_none(item) for item in value]
    return value
