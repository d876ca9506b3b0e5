"""The clock of a calibration: runs stages, tells their progress and keeps their times."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import nullcontext
from functools import lru_cache
from typing import TypeVar

from threadpoolctl import ThreadpoolController

from skin2urdf.arrays import give_back_freed_memory

T = TypeVar("T")
Tell = Callable[[float], None]
"""Called with the share of a stage that is done, in [0, 1]."""
Progress = Callable[[str, float], None]
"""Called with the name of a stage and the share of it that is done, in [0, 1]."""
_LONG = 5.0
"""Time of a stage [s] from which it may leave memory that is worth giving back. Stages of a small
log take less; for all of them that would be a fortieth of its time."""


class Clock:
    """Runs stages, tells progress and keeps their times.

    A stage may run others: while one of them runs, its time is its own and not that of the stage
    that called it. So all times together are the time that passed in stages.

    Attributes:
        seconds: time of each stage, of all its runs together [s].
    """

    def __init__(self, progress: Progress | None = None) -> None:
        self._progress: Progress = progress or (lambda _stage, _share: None)
        self._inside = [0.0]  # time of the stages that the running ones have called
        self.seconds: dict[str, float] = {}

    def run(self, stage: str, work: Callable[[Tell], T]) -> T:
        """Run one stage; its time is added to earlier runs of the same name, failed ones too."""
        begin = time.perf_counter()
        self._progress(stage, 0.0)
        self._inside.append(0.0)
        try:
            # The matrices are many and small: threads of linear algebra would wait for each other.
            # A stage inside another finds it done.
            outermost = len(self._inside) == 2
            with _libraries(len(sys.modules)).limit(limits=1) if outermost else nullcontext():
                result = work(lambda share: self._progress(stage, share))
        finally:
            whole = time.perf_counter() - begin
            own = whole - self._inside.pop()
            self._inside[-1] += whole
            self.seconds[stage] = self.seconds.get(stage, 0.0) + own
        if whole > _LONG:
            give_back_freed_memory()
        self._progress(stage, 1.0)
        return result


@lru_cache(maxsize=1)
def _libraries(modules: int) -> ThreadpoolController:
    """Those of linear algebra that are loaded.

    They come with modules. To look for them takes 6 ms, more than many a stage of a small log.

    Args:
        modules: number of modules that are loaded.
    """
    del modules
    return ThreadpoolController()
