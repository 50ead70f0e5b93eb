"""Whether a recording has what it takes to run it again; read without the simulator."""

from pathlib import Path

from robrain.protocol.wire.endpoint import Drive
from robrain.recording.errors import RecordingError
from robrain.recording.provenance import SETUP_ATTACHMENT, Provenance, RunSetup
from robrain.recording.reader.reading import read_provenance


def repeatable(path: Path) -> tuple[Provenance, RunSetup]:
    """What a recorded run was started with, and what it takes to make it again.

    Raises:
        RecordingError: the file is no recording, or cannot be run again; the text says why.

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
