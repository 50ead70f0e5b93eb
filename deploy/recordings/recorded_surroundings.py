"""The place of a recorded run, as far as the file and the installed packages tell."""

import tempfile
from pathlib import Path

from robrain.protocol.extras import missing_package
from robrain.recording.errors import RecordingError
from robrain.recording.invariants.findings import MissingEvidence
from robrain.recording.invariants.invariant_judge import NOWHERE, Surroundings
from robrain.recording.reader.reading import read_provenance


def surroundings_of_recording(path: Path) -> Surroundings:
    """Walls and chargers of a recorded run; None where the file does not tell, or the simulator is not installed."""
    try:
        provenance = read_provenance(path)
    except RecordingError:  # it may be a recording of something else, and can be checked all the same
        return NOWHERE
    if provenance.setup is None and not provenance.scenario_toml:
        return NOWHERE
    try:
        from robrain.deploy.recordings.scenario_surroundings import surroundings_of_provenance
    except ModuleNotFoundError as error:  # recordings are checked without the simulator too
        if missing_package(error) is None:
            raise
        return Surroundings(no_floor=MissingEvidence.SIMULATOR)
    with tempfile.TemporaryDirectory(prefix="robrain-check-") as folder:
        return surroundings_of_provenance(provenance, Path(folder))
