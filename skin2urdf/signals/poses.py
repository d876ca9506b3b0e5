"""Where the robot rests and around which poses it excites its joints, from positions alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool, Int, Record
from skin2urdf.signals.filters import Grid, filtered, first_derivative, low_pass
from skin2urdf.signals.motion import Motion

_SETTLED = 6.0
"""Cutoff [Hz] of the low-pass of the positions that tell whether joints rest."""
_SHORTEST_REST = 0.25
"""Time [s] that is a rest: two low-passes of some Hz have settled in its middle."""
_LARGEST_SPEED = 0.05
"""Speed [rad/s or m/s] up to which a joint rests: at half a metre it is felt with 1 mm/s^2."""
_SAME_POSE = 0.03
"""Positions [rad or m], and share of a joint's range, that are one pose: what regressors of a pose
lack beyond first order is then a thousandth of gravity."""
_LARGEST_EXCURSION = 0.75
"""Excursion [rad or m] around a rest beyond which a joint is on its way to another pose."""
_SMALL_EXCURSION = 0.25
"""Excursion [rad or m] that is small however little a joint moves in all: a joint that moves in its
patterns alone spans no more than they do."""


@dataclass(frozen=True, eq=False)
class Rest(Record):
    """An interval in which no joint moves.

    Attributes:
        begin: first grid sample.
        end: one past the last.
        q: (D,) mean positions [rad or m].
        still: False where joints do move, and it stands for a rest that the log lacks.
    """

    begin: int
    end: int
    q: F64
    still: bool = True


@dataclass(frozen=True, eq=False)
class Neighbourhood(Record):
    """A pose and all intervals in which the robot rests in it or moves a little around it.

    Attributes:
        q: (D,) the pose: mean positions of its rests [rad or m].
        windows: grid intervals (begin, end), each starting and ending at rest.
        left: whether the robot leaves it in some window and comes back, as with a pattern; what
            moves while it stays is the servo's work.
    """

    q: F64
    windows: tuple[tuple[int, int], ...]
    left: bool = True

    def span(self, grid: Grid) -> tuple[float, float]:
        """Begin of the first interval and end of the last [s]; no other pose has both."""
        return float(grid.time[self.windows[0][0]]), float(grid.time[self.windows[-1][1] - 1])


def find_rests(motion: Motion) -> tuple[Rest, ...]:
    """All rests of a quarter of a second or longer."""
    still = _still(motion).all(axis=1) & motion.valid
    return tuple(
        Rest(begin, end, motion.q[begin:end].mean(axis=0))
        for begin, end in _intervals(still, motion.grid.rate)
    )


def find_stops(motion: Motion) -> Int:
    """Grid samples at which a joint comes to rest for a quarter of a second or longer, increasing.

    Others may move on. A log that begins at rest does not begin with a stop.
    """
    still = _still(motion)
    begins = (begin for one in still.T for begin, _ in _intervals(one, motion.grid.rate) if begin)
    return np.unique(np.fromiter(begins, dtype=np.int64))


def _still(motion: Motion) -> Bool:
    """(N, D) where joints are slower than what encoders make of rest, and patterns of motion."""
    rate = motion.grid.rate
    speed = np.abs(first_derivative(filtered(motion.q, low_pass(_SETTLED, rate)), rate))
    span = np.ptp(motion.q, axis=0)
    floor = motion.noise * np.sqrt(2 * _SETTLED / motion.raw_rate) * 2 * np.pi * _SETTLED
    largest = np.maximum(_LARGEST_SPEED, 6 * floor)
    return np.asarray(speed < np.clip(np.maximum(0.012 * span, 6 * floor), 1e-4, largest))


def _intervals(still: Bool, rate: float) -> Iterator[tuple[int, int]]:
    """Begin and end of what lasts for a rest in (N,) samples."""
    edges = np.flatnonzero(np.diff(np.r_[False, still, False].astype(np.int8)))
    for begin, end in edges.reshape(-1, 2).tolist():
        if end - begin >= _SHORTEST_REST * rate:
            yield begin, end


def stop_blur(rate: float) -> int:
    """Samples by which the begin of a rest may be early or late: half a period at that cutoff.

    Args:
        rate: samples per second [Hz].
    """
    return int(np.ceil(0.5 * rate / _SETTLED))


def slowest_moments(motion: Motion, most: int = 8) -> tuple[Rest, ...]:
    """Quarters of a second in which the joints move least, for logs of robots that never rest.

    Args:
        motion: the motion.
        most: how many, at most; they do not overlap.
    """
    n = max(1, round(_SHORTEST_REST * motion.grid.rate))
    size = len(motion.q) // n * n
    span = np.maximum(np.ptp(motion.q, axis=0), 1e-3)
    speed = (np.abs(motion.qd[:size]) / span).max(axis=1).reshape(-1, n).max(axis=1)
    speed = np.where(motion.valid[:size].reshape(-1, n).all(axis=1), speed, np.inf)
    chosen = [int(i) for i in np.argsort(speed)[:most] if np.isfinite(speed[i])]
    return tuple(
        Rest(i * n, (i + 1) * n, motion.q[i * n : (i + 1) * n].mean(axis=0), still=False)
        for i in sorted(chosen)
    )


def find_neighbourhoods(motion: Motion, rests: tuple[Rest, ...]) -> tuple[Neighbourhood, ...]:
    """Group rests and the excursions between them into poses.

    Two rests in a row belong together, with the motion between them, when they lie at the same
    positions and the motion stays near. Rests at the same positions at other times join in.
    """
    span = np.ptp(motion.q, axis=0)
    same = np.minimum(_SAME_POSE, np.maximum(_SAME_POSE * span, 1e-3))
    largest = np.minimum(_LARGEST_EXCURSION, np.maximum(0.6 * span, _SMALL_EXCURSION))
    groups: list[tuple[list[Rest], list[list[int]]]] = []
    heads = np.empty((len(rests), len(span)))
    left = set[int]()
    previous: Rest | None = None
    current: int | None = None
    for rest in rests:
        joined = False
        if previous is not None and current is not None:
            between = motion.q[previous.begin : rest.end]
            near = bool((np.abs(between - previous.q) <= largest).all())
            whole = bool(motion.valid[previous.begin : rest.end].all())
            if near and whole and bool((np.abs(rest.q - previous.q) <= same).all()):
                groups[current][0].append(rest)
                groups[current][1][-1][1] = rest.end
                if (np.ptp(between, axis=0) > same).any():
                    left.add(current)
                joined = True
        if not joined:
            match = (np.abs(heads[: len(groups)] - rest.q) <= same).all(axis=1)
            if match.any():
                current = int(match.argmax())
                groups[current][0].append(rest)
                groups[current][1].append([rest.begin, rest.end])
            else:
                heads[len(groups)] = rest.q
                groups.append(([rest], [[rest.begin, rest.end]]))
                current = len(groups) - 1
        previous = rest
    out = []
    for g, (members, windows) in enumerate(groups):
        length = np.array([r.end - r.begin for r in members], dtype=np.float64)
        q = np.average([r.q for r in members], axis=0, weights=length)
        out.append(Neighbourhood(q, tuple((a, b) for a, b in windows), g in left))
    return tuple(out)
