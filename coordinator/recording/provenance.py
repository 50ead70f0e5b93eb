"""Where a recording comes from: what it takes to make the same run again.

Nothing in it tells the time of day or the machine's folders, so equal runs leave equal files.
"""

import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version

import msgspec

PACKAGES = ("robrain", "eclipse-zenoh", "pymunk", "numpy", "mcap")
"""Distributions whose version can change what a run does."""

RUN_METADATA = "robrain.run"
VERSIONS_METADATA = "robrain.versions"
SUMMARY_METADATA = "robrain.summary"
SCENARIO_ATTACHMENT = "scenario.toml"
MAP_ATTACHMENT = "map.png"


class Provenance(msgspec.Struct, frozen=True):
    """What a run was started with."""

    scenario: str
    """Name of the scenario; empty for a team without one."""
    scenario_toml: str
    """Its text, as it was read."""
    seed: int
    map_png: bytes | None
    """Picture of the arena, PNG."""
    drive: str
    team: str

    def run_metadata(self) -> dict[str, str]:
        """The fields that are short enough for a metadata record."""
        return {"scenario": self.scenario, "seed": str(self.seed), "drive": self.drive, "team": self.team}

    @classmethod
    def from_parts(cls, run: Mapping[str, str], attachments: Mapping[str, bytes]) -> "Provenance":
        """Put together again what a file holds.

        Raises:
            KeyError: a part is missing.
            ValueError: a part is not what robrain writes.
        """
        return cls(
            scenario=run["scenario"],
            scenario_toml=attachments[SCENARIO_ATTACHMENT].decode(),
            seed=int(run["seed"]),
            map_png=attachments.get(MAP_ATTACHMENT),
            drive=run["drive"],
            team=run["team"],
        )


def software_versions() -> dict[str, str]:
    """Version of Python and of each of `PACKAGES`; those that are not installed are left out."""
    versions = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    return versions
