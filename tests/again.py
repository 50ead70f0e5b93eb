"""A second look at tests that failed beside others: each is run once more, alone.

`python -m tests.again STATUS` after a run of pytest that ended with STATUS. Tests of real processes share the cores
with other tests and may fail for that; a defect fails alone, too. What failed once is named either way. More than
`MOST` failures, and errors that are no failed tests, are not looked at again.
"""

import json
import sys
from pathlib import Path

import pytest

FAILED = Path(".pytest_cache/v/cache/lastfailed")
MOST = 3


def main() -> int:
    """Run them; the exit status of `make test`."""
    status = int(sys.argv[1])
    if status != pytest.ExitCode.TESTS_FAILED or not FAILED.exists():
        return status
    failed = sorted(json.loads(FAILED.read_text()))
    if len(failed) > MOST:
        return status
    sys.stdout.write("\n".join(["", "once more, alone, as they failed beside other tests:", *failed, ""]))
    sys.stdout.flush()
    return int(pytest.main(["--last-failed", "--last-failed-no-failures=none", "--numprocesses=0", "-rA"]))


if __name__ == "__main__":
    sys.exit(main())
