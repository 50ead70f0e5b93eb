import subprocess
import sys
from collections.abc import Callable
from types import ModuleType

import pytest
from numba.core.dispatcher import Dispatcher

from robrain.algorithms.localization import mote_relocalisation, surface_match
from robrain.algorithms.mapping import occupancy_grid, ray_cast
from robrain.algorithms.navigation import frontier, path_planning, right_of_way
from robrain.algorithms.navigation import navigation_grid as navigation
from robrain.algorithms.numeric import small_linear_algebra
from robrain.algorithms.slam import pose_graph, robots_in_scan, submap, submap_atlas
from robrain.algorithms.warm_up import warm_up
from robrain.sim.scenarios.scenario import Scenario

pytestmark = pytest.mark.slow

MODULES: tuple[ModuleType, ...] = (
    frontier,
    robots_in_scan,
    occupancy_grid,
    path_planning,
    pose_graph,
    ray_cast,
    right_of_way,
    small_linear_algebra,
    submap,
    submap_atlas,
    surface_match,
)


def compiled() -> dict[str, int]:
    """How many variants of each kernel have been compiled or loaded."""
    return {
        name: len(kernel.signatures)
        for module in MODULES
        for name, kernel in vars(module).items()
        if isinstance(kernel, Dispatcher)
    }


def kernels_of(module: ModuleType) -> set[Dispatcher]:
    return {kernel for kernel in vars(module).values() if isinstance(kernel, Dispatcher)}


def test_no_kernel_is_left_to_compile_while_robots_drive_map_and_give_way() -> None:
    # In a process of its own: here, other tests have warmed the kernels up.
    subprocess.run([sys.executable, __file__], check=True, timeout=500)


def test_warming_up_calls_each_kernel_of_maps_paths_obstacles_and_motes(monkeypatch: pytest.MonkeyPatch) -> None:
    # As plain Python, so that it does not matter which kernels have been compiled already.
    called: set[Dispatcher] = set()

    def plain(kernel: Dispatcher) -> Callable[..., object]:
        def call(*arguments: object) -> object:
            called.add(kernel)
            return kernel.py_func(*arguments)

        return call

    others = (navigation, mote_relocalisation)
    needed = {kernel for module in (*MODULES, *others) for kernel in kernels_of(module)}
    models = [module for name, module in sys.modules.items() if name.startswith("robrain.algorithms.")]
    for module in models:
        for name, kernel in list(vars(module).items()):
            if isinstance(kernel, Dispatcher):
                monkeypatch.setattr(module, name, plain(kernel))
    warm_up()
    assert {kernel.py_func.__name__ for kernel in needed - called} == set()


if __name__ == "__main__":
    assert not any(compiled().values()), "importing the model compiled something"
    warm_up()
    warm = compiled()
    Scenario.builtin("arena_small").replace(seed=3, robots=3, time_limit_s=40.0).run()
    assert compiled() == warm, f"after the warm-up {warm}, in use {compiled()}"
