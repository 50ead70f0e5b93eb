"""Origin of a recording: the data that repeat its run.

It has neither the time of day nor the machine's folders, so equal runs leave equal files.
"""

import base64
import os
import platform
import zlib
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version

import msgspec

PACKAGES = ("robrain", "eclipse-zenoh", "pymunk", "numpy", "mcap")
"""Distributions whose version can change a run."""

RUN_METADATA = "robrain.run"
VERSIONS_METADATA = "robrain.versions"
SUMMARY_METADATA = "robrain.summary"
HOST_METADATA = "robrain.host"
PART_METADATA = "robrain.part"
"""Of a recording that is split: the number of this file, from 1."""
RECOVERY_METADATA = "robrain.recovery"
VISUAL_METADATA = "robrain.visual"
SCENARIO_ATTACHMENT = "scenario.toml"
MAP_ATTACHMENT = "map.png"
SETUP_ATTACHMENT = "setup.toml"
"""The scenario as it was run, with every key: of a lockstep run."""
MAP_YAML_ATTACHMENT = "map.yaml"
"""Scale and origin of `map.png`, where the floor came from a map file."""
FORK_METADATA = "robrain.fork"
"""Of a fork: its parent, and the changes."""
MANIFESTS_METADATA = "robrain.manifests"
"""All manifests in one record, deflated: there are dozens, much alike, and each part of a recording has them."""


SCRIPT = "script"
PACKING = "base64 of the zlib-deflated JSON object of path and text"
MANIFESTS_MAX = 64 * 1024 * 1024
"""Bytes that manifests unpack to at the most."""


class RunSetup(msgspec.Struct, frozen=True, kw_only=True):
    """The inputs by which a lockstep run can be repeated."""

    toml: str
    """The scenario as it was run, as a scenario file with every key; its map file, if it has one, is `map.yaml`."""
    map_yaml: str = ""
    """Scale and origin of the map picture, in the map_server format; empty for a floor that the scenario draws."""
    is_script: bool = False
    """Whether a script ran the team, and ended the run when it had finished."""
    fork: dict[str, str] = {}
    """Of a fork: `parent`, `parent_digest`, `at_s` and `changes`; empty for a run that is none."""


class Provenance(msgspec.Struct, frozen=True):
    """The inputs of a run."""

    scenario: str
    """Name of the scenario; empty for a team without one."""
    scenario_toml: str
    """Its text, as it was read."""
    seed: int
    map_png: bytes | None
    """Picture of the arena, PNG."""
    drive: str
    team: str
    manifests: dict[str, str] = {}
    """Files of the robots and of their plugins, as text, by a path for each."""
    setup: RunSetup | None = None
    """The inputs by which the run can be repeated; None for a live one."""

    def metadata(self) -> dict[str, dict[str, str]]:
        """The metadata records of a recording, by name."""
        run = {"scenario": self.scenario, "seed": str(self.seed), "drive": self.drive, "team": self.team}
        if self.setup is not None and self.setup.is_script:
            run["run_by"] = SCRIPT
        records = {RUN_METADATA: run}
        if self.manifests:
            packed = base64.b64encode(zlib.compress(msgspec.json.encode(self.manifests), 9)).decode()
            names = ", ".join(sorted(self.manifests))
            records[MANIFESTS_METADATA] = {"names": names, "packed": packed, "packing": PACKING}
        if self.setup is not None and self.setup.fork:
            records[FORK_METADATA] = self.setup.fork
        return records

    def attachments(self) -> list[tuple[str, str, bytes]]:
        """The attachments of a recording: name, media type and content."""
        found = [(SCENARIO_ATTACHMENT, "application/toml", self.scenario_toml.encode())]
        if self.map_png is not None:
            found.append((MAP_ATTACHMENT, "image/png", self.map_png))
        if self.setup is not None:
            found.append((SETUP_ATTACHMENT, "application/toml", self.setup.toml.encode()))
            if self.setup.map_yaml:
                found.append((MAP_YAML_ATTACHMENT, "application/yaml", self.setup.map_yaml.encode()))
        return found

    @classmethod
    def from_records(cls, metadata: Mapping[str, Mapping[str, str]], attachments: Mapping[str, bytes]) -> "Provenance":
        """Restore the provenance from the metadata records and attachments of a recording.

        Raises:
            KeyError: a part is missing.
            ValueError: a part was not written by robrain.
        """
        run, manifests = metadata[RUN_METADATA], metadata.get(MANIFESTS_METADATA)
        setup = None
        if SETUP_ATTACHMENT in attachments:
            setup = RunSetup(
                toml=attachments[SETUP_ATTACHMENT].decode(),
                map_yaml=attachments.get(MAP_YAML_ATTACHMENT, b"").decode(),
                is_script=run.get("run_by") == SCRIPT,
                fork=dict(metadata.get(FORK_METADATA, {})),
            )
        return cls(
            scenario=run["scenario"],
            scenario_toml=attachments[SCENARIO_ATTACHMENT].decode(),
            seed=int(run["seed"]),
            map_png=attachments.get(MAP_ATTACHMENT),
            drive=run["drive"],
            team=run["team"],
            manifests=unpacked(manifests) if manifests else {},
            setup=setup,
        )


def unpacked(manifests: Mapping[str, str]) -> dict[str, str]:
    """The manifests in a metadata record.

    Raises:
        KeyError: a part is missing.
        ValueError: it was not packed by robrain.
    """
    inflater = zlib.decompressobj()
    try:
        text = inflater.decompress(base64.b64decode(manifests["packed"], validate=True), MANIFESTS_MAX)
        return msgspec.json.decode(text, type=dict[str, str])
    except (zlib.error, msgspec.DecodeError) as error:
        raise ValueError(f"the manifests do not unpack: {error}") from error


def software_versions(more: Sequence[str] = ()) -> dict[str, str]:
    """Version of Python, of each of `PACKAGES` and of `more`; packages that are not installed are skipped."""
    versions = {"python": platform.python_version()}
    for package in (*PACKAGES, *more):
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    return versions


def host_description() -> dict[str, str]:
    """The machine that records: the properties on which its figures depend, and no name of it."""
    return {
        "system": platform.system(),
        "release": platform.release(),
        "machine": platform.machine(),
        "processors": str(os.cpu_count() or 0),
    }
