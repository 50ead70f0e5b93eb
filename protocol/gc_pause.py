"""Python's garbage collector during a run: objects of the setup stay, so it does not scan them again.

To look through all that a coordinator has imported takes a tenth of a second, in which nothing else runs.
"""

import gc

YOUNG_OBJECTS = 20_000
"""This number of new container objects starts a collection; Python's own 700 are a tick of a few robots."""


class GcPause:
    """While at least one is held, the collector skips the existing objects, and scans new ones less often.

    A run makes next to no cycles: released objects are freed immediately, without the collector.
    """

    _held = 0
    _usual: tuple[int, int, int] = (0, 0, 0)

    def __init__(self) -> None:
        self._is_held = True
        if not GcPause._held:
            GcPause._usual = gc.get_threshold()
            gc.set_threshold(YOUNG_OBJECTS, *GcPause._usual[1:])
        GcPause._held += 1
        gc.collect(1)  # young objects; all objects of a large process would take a second
        gc.freeze()

    def settle(self) -> None:
        """Skip the objects built since as well."""
        gc.freeze()

    def release(self) -> None:
        """Restore the collector and collect, once no other is held; calling it again does nothing."""
        if self._is_held:
            self._is_held = False
            GcPause._held -= 1
            if not GcPause._held:
                gc.set_threshold(*GcPause._usual)
                gc.unfreeze()
                gc.collect()  # what was frozen counts as old, and is looked at once in thousands of runs
