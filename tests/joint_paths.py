"""Joint motion put together by hand: rests, moves and patterns, sampled like a log would.

Nothing of the package's simulation is used, so that both can be wrong on their own only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.recording.records import JointStream, Recording, SuStream
from skin2urdf.signals.motion import Motion, joint_motion

FINE = 2000.0
"""Rate of the points between which a path is interpolated [Hz]."""


class JointPath:
    """Positions of D joints over time, built piece by piece."""

    def __init__(self, start: Sequence[float]) -> None:
        self._here = np.array(start, dtype=np.float64)
        self._pieces = [self._here[None]]

    def rest(self, seconds: float) -> JointPath:
        """Stay."""
        return self._add(np.tile(self._here, (round(seconds * FINE), 1)))

    def move(self, goal: Sequence[float], seconds: float = 1.5) -> JointPath:
        """Go to a goal with continuous jerk."""
        x = np.linspace(0.0, 1.0, round(seconds * FINE))[:, None]
        step = x**4 * (35 - 84 * x + 70 * x**2 - 20 * x**3)
        return self._add(self._here + step * (np.array(goal) - self._here))

    def swing(
        self, offsets: dict[int, float], seconds: float = 2.0, hertz: float = 2.0
    ) -> JointPath:
        """Swing some joints out by up to an offset [rad or m] and back, under a smooth window.

        Several joints swing at different frequencies.
        """
        t = np.arange(round(seconds * FINE)) / FINE
        window = np.sin(np.pi * t / seconds) ** 4
        piece = np.tile(self._here, (t.size, 1))
        for i, (joint, offset) in enumerate(offsets.items()):
            f = hertz * (1 + 0.31 * i)
            piece[:, joint] += offset / 2 * (1 - np.cos(2 * np.pi * f * t)) * window
        return self._add(piece)

    def follow(self, offsets: F64) -> JointPath:
        """(n, D) offsets from here, one after the other at `FINE`; the last is where it stays."""
        return self._add(self._here + offsets)

    def abrupt(self, joint: int, size: float, *, seconds: float, hertz: float) -> JointPath:
        """A sine of one joint that begins and ends at full speed."""
        t = np.arange(round(seconds * FINE)) / FINE
        piece = np.tile(self._here, (t.size, 1))
        piece[:, joint] += size * np.sin(2 * np.pi * hertz * t)
        return self._add(np.concatenate([piece, self._here[None]]))

    @property
    def time(self) -> F64:
        """(N,) times of the points [s]."""
        return np.arange(sum(map(len, self._pieces))) / FINE

    @property
    def position(self) -> F64:
        """(N, D) the points."""
        return np.concatenate(self._pieces)

    def at(self, time: F64) -> F64:
        """(M, D) positions at some times."""
        q = self.position
        return np.stack([np.interp(time, self.time, column) for column in q.T], axis=1)

    def recording(
        self,
        rate: float = 250.0,
        sus: Sequence[SuStream] = (),
        disturbance: F64 | None = None,
    ) -> Recording:
        """The joints' streams, named a, b, c, ...; ``disturbance`` (M, D) is added to samples."""
        time = np.arange(0.0, self.time[-1], 1 / rate)
        q = self.at(time) + (0.0 if disturbance is None else disturbance[: time.size])
        joints = tuple(JointStream(chr(97 + d), time, q[:, d]) for d in range(q.shape[1]))
        return Recording(joints, tuple(sus), source="a path made by hand")

    def motion(self, rate: float = 250.0, disturbance: F64 | None = None) -> Motion:
        """The recording's motion."""
        return joint_motion(self.recording(rate, disturbance=disturbance))

    def _add(self, piece: F64) -> JointPath:
        self._pieces.append(piece)
        self._here = piece[-1].copy()
        return self
