"""How many files a task passes through: one robot, one visit, traced from its submission to the first wheel command.

`python -m tests.bench.task_path` prints each file with the number of its functions. Counted is what runs only because
of the task, without functions that an idle team enters as well, and without imports.
"""

import sys
from collections import Counter, defaultdict
from types import FrameType
from typing import Any

from robrain import Point2D, Scenario, Task
from robrain.plugins.device.mocdevice.mocdevice import MocDevice

Functions = dict[str, set[str]]
"""Names of functions by the file that they are in."""
PACKAGE = "/robrain/"
SETTLE_S = 2.0
IDLE_TICKS = 50
TASK_TICKS = 500
VISIT = Task(id="visit-1", kind="visit", place=Point2D(2.0, 2.0))


class Trace:
    """Notes each function of robrain that is entered, up to the first command that turns the wheels."""

    def __init__(self) -> None:
        self.entered: Functions = defaultdict(set)
        self.drives = False

    def __call__(self, frame: FrameType, event: str, _argument: Any) -> None:
        """Called by Python for each call and return."""
        code = frame.f_code
        if event != "call" or PACKAGE not in code.co_filename or "site-packages" in code.co_filename:
            return
        self.entered[code.co_filename.rpartition(PACKAGE)[2]].add(code.co_qualname)
        if code is MocDevice.drive.__code__:
            twist = frame.f_locals["twist"]
            self.drives |= any((twist.forward_m_s, twist.left_m_s, twist.yaw_rad_s))


def path_of_a_visit() -> Functions:
    """The functions that run because of the visit, by file."""
    idle = _entered(has_task=False)
    with_task = _entered(has_task=True)
    only = {file: names - idle.get(file, set()) - {"<module>"} for file, names in with_task.items()}
    return {file: names for file, names in sorted(only.items()) if names}


def _entered(*, has_task: bool) -> Functions:
    with Scenario.builtin("arena_small").replace(robots=1, motes=0, seed=1).team() as team:
        run = team.transport.run
        team.run_for(300.0, lambda: run.nothing_left)
        team.run_for(SETTLE_S)
        trace = Trace()
        sys.setprofile(trace)
        try:
            if has_task:
                team.submit(VISIT)
            for _ in range(TASK_TICKS if has_task else IDLE_TICKS):
                run.tick()
                if trace.drives:
                    break
        finally:
            sys.setprofile(None)
    assert trace.drives is has_task
    return trace.entered


def main() -> None:
    """Print the path."""
    path = path_of_a_visit()
    for file, names in path.items():
        sys.stdout.write(f"{len(names):4}  {file}\n")
    shares = Counter(file.partition("/")[0] for file in path)
    packages = ", ".join(f"{package} {count}" for package, count in shares.most_common())
    sys.stdout.write(f"{len(path)} files ({packages}), {sum(map(len, path.values()))} functions\n")


if __name__ == "__main__":
    main()
