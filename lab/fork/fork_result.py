"""Result of a fork; read without the simulator."""

from pathlib import Path

import msgspec

from robrain.protocol.wire.endpoint import Drive
from robrain.recording.errors import RecordingError
from robrain.recording.provenance import SETUP_ATTACHMENT, Provenance, RunSetup
from robrain.recording.reader.reading import read_provenance
from robrain.recording.reader.two_runs import Difference


class ForkResult(msgspec.Struct, frozen=True, kw_only=True):
    """A fork, and how the part before it compares with the recording."""

    recording: Path
    parent: Path
    at_s: float
    changes: list[str]
    """In words; empty if nothing was changed."""
    same_before: bool
    """Whether all messages up to the moment equal those of the recording."""
    messages_before: int
    """Messages up to the moment that were equal."""
    digest_before: str
    """Digest of the run up to the moment."""
    recorded_digest_before: str
    """Digest of the recording up to there, or up to the first difference."""
    same_whole: bool | None
    """Whether the whole run was equal; None for a fork with changes, or with another end time."""
    difference: Difference | None
    """The first message that differs where none should; the first value is the recording's."""
    ended: str
    """`explored`, `nothing_left`, `time_limit`, `interrupted`, `as_recorded` or `seconds`."""
    sim_time_s: float
    explored_fraction: float
    messages: int
    digest: str
    other_versions: list[str]
    """Software with another version than that of the recording."""
    not_repeated: list[tuple[float, str]]
    """Inputs from other processes that cannot be repeated: time and key."""


def fork_name(path: Path, at_s: float) -> Path:
    """The file that a fork is written to unless another is given.

    >>> fork_name(Path("runs/depot-1.mcap"), 412.0).as_posix()
    'runs/depot-1.fork-412s.mcap'
    """
    return path.with_name(f"{path.stem}.fork-{at_s:g}s{path.suffix}")


def repeatable(path: Path) -> tuple[Provenance, RunSetup]:
    """Provenance of a recorded run, and the setup that repeats it.

    Raises:
        RecordingError: the file is no recording, or cannot be run again; the text gives the reason.

    """
    provenance = read_provenance(path)
    if provenance.drive != Drive.LOCKSTEP:
        raise RecordingError(path, f"{path} cannot be run again: it was recorded live, and only lockstep runs repeat")
    if provenance.setup is None:
        raise RecordingError(
            path,
            f"{path} cannot be run again: it lacks {SETUP_ATTACHMENT}, the scenario as it was run; record it again "
            "with this version of robrain",
        )
    return provenance, provenance.setup
