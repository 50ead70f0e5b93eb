"""The robot of examples/09_any_language, faster, at another place, and with a log of the tasks that it has done.

robrain wire --format jsonschema | python tests/deploy/vda5050/fast_robot.py ENDPOINT NAME LOG X_M
"""

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[3] / "examples" / "09_any_language"))
import robot as example

LOG = Path(sys.argv[3])


class FastRobot(example.Robot):  # type: ignore[misc]
    def end(self, state: str, why: str = "") -> None:
        if state == "done":
            with LOG.open("a") as stream:
                stream.write(f"{self.name} {self.status['id']}\n")
        super().end(state, why)

    def plugins(self, _request: Any) -> Any:
        return [*super().plugins(_request)]


if __name__ == "__main__":
    example.SPEED_M_S, example.START, example.Robot = 8.0, (float(sys.argv[4]), 3.0), FastRobot
    example.main()
