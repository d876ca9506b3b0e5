"""What gyroscopes say, on the grid of a log: rates of turn of the SUs that have one.

An SU turns by the velocities of the joints that carry it and by nothing else, whatever gravity
does: ``w = sum over joints d of w_d qd_d``. The Earth's own rotation, 15 deg an hour, is part of a
gyroscope's bias as far as the SU keeps its orientation; it is a twentieth of what noise of
0.1 deg/s leaves in a second's mean.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Bool, Int, Record
from skin2urdf.notes import Note
from skin2urdf.recording.credibility import spikes
from skin2urdf.recording.holding import measurements
from skin2urdf.recording.records import SuStream
from skin2urdf.signals.filters import sample, spread
from skin2urdf.signals.health import clipping
from skin2urdf.signals.motion import Motion

_TOO_FAST = 5.0
"""Rate of an SU, over the sum of the speeds of all joints, from which it is in deg/s: in rad/s it
is at most 1, in deg/s 57 where the joint that turns fastest carries the SU."""
_MOVING = 0.05
"""Sum of the joints' speeds [rad/s] above which that is judged: ten times what noise of 0.3 deg/s
reads as."""


@dataclass(frozen=True, eq=False)
class Turning(Record):
    """Rates of turn of U SUs on a grid.

    Attributes:
        rates: (N, U, 3) as the gyroscopes read them, in the SUs' frames [rad/s].
        valid: (N, U) where they are whole; nowhere for SUs without a gyroscope.
    """

    rates: F64
    valid: Bool

    def of(self, columns: Int) -> Turning:
        """The rates of other columns."""
        return Turning(self.rates[:, columns], self.valid[:, columns])

    def where(self, kept: Bool) -> Turning:
        """The rates without those at (N, U) samples that are not kept."""
        return replace(self, valid=self.valid & kept)

    def exchanged(self, columns: Int, later: Bool) -> Turning:
        """The rates with those of other columns (U,) at (N, U) samples."""
        other = self.of(columns)
        return Turning(
            np.where(later[..., None], other.rates, self.rates),
            np.where(later, other.valid, self.valid),
        )


def sampled_turning(
    sus: Mapping[str, SuStream], su_names: Sequence[str], motion: Motion, still: Bool
) -> tuple[Turning | None, tuple[Note, ...]]:
    """Put what gyroscopes read on the grid of a log.

    Args:
        sus: the streams by name, on the joints' clock.
        su_names: U names.
        motion: joint motion of the log.
        still: (N,) True where the robot rests.

    Returns:
        The rates, None where no SU has a gyroscope; and notes for the user.
    """
    if all(su.angular_velocity is None for su in sus.values()):
        return None, ()
    grid = motion.grid
    rates = np.zeros((grid.size, len(su_names), 3))
    valid = np.zeros((grid.size, len(su_names)), dtype=bool)
    notes = []
    for u, name in enumerate(su_names):
        su = sus.get(name)
        if su is None or su.angular_velocity is None:
            continue
        time, values = _measured(su.time, su.angular_velocity)
        rates[:, u], whole = sample(time, values, grid)
        at_rest = still[np.clip(((time - grid.start) * grid.rate).astype(int), 0, grid.size - 1)]
        clipped = spread(time, clipping(values, at_rest), grid)
        valid[:, u] = whole & motion.valid & ~clipped
        if _in_degrees(rates[valid[:, u], u], motion.qd[valid[:, u]]):
            rates[:, u] = np.deg2rad(rates[:, u])
            notes.append(Note("unit deg/s", (name,)))
    return Turning(rates, valid), tuple(notes)


def _measured(time: F64, rates: F64) -> tuple[F64, F64]:
    """Times (M,) and rates (M, 3) that are measurements: no spikes, none that is sent again."""
    known = np.isfinite(rates).all(axis=1)
    time, values = time[known], rates[known]
    alone = spikes(values)
    time, values = time[~alone], values[~alone]
    held = measurements(values, time)
    return time[held.kept], values[held.kept]


def _in_degrees(rates: F64, speeds: F64) -> bool:
    """Whether rates (M, 3) are far beyond what joint velocities (M, D) can make of them."""
    total = np.abs(speeds).sum(axis=1)
    moving = total > _MOVING
    if not moving.any():
        return False
    turn = np.linalg.norm(rates - np.median(rates, axis=0), axis=1)[moving]
    return bool(np.quantile(turn / total[moving], 0.9) > _TOO_FAST)
