"""Work on many alike things, some of them at a time.

NumPy and SciPy let other threads run while they work on long arrays. What each thing asks for has
to be much beside the time that Python itself takes, which no other thread can use.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

WORKERS = min(4, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 2)
"""Threads at most: as many as there are cores to use, and four, whose arrays are in memory at a
time."""
MANY = 100
"""SUs, or fits of chains, from which work on them is shared among threads. A calibration of fewer
takes seconds, and where there are many such, each has a core of its own."""


def each(work: Callable[[T], R], things: Iterable[T], count: int) -> Iterator[R]:
    """What work makes of each thing, in their order.

    Args:
        work: may run for several things at a time, and so writes to nothing that it reads or writes
            for another one.
        things: the things, of which few are asked for ahead.
        count: number of SUs, or fits, that they are about; of few one thing is done after the
            other.
    """
    if count < MANY or WORKERS == 1:
        yield from map(work, things)
        return
    with ThreadPoolExecutor(WORKERS) as pool:
        ahead: deque[Future[R]] = deque()
        for thing in things:
            ahead.append(pool.submit(work, thing))
            if len(ahead) > WORKERS:
                yield ahead.popleft().result()
        while ahead:
            yield ahead.popleft().result()


def do_each(work: Callable[[T], object], things: Iterable[T], count: int) -> None:
    """Work on each thing, as above, where nothing but what it writes to is wanted."""
    deque(each(work, things, count), maxlen=0)
