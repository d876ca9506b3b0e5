"""A tree in growth: segments whose rotation is known, and how well each SU would sit on each.

Every segment whose rotation is known carries upward gravity into its frame. An SU sits on it if a
constant orientation explains what it feels. What a fit leaves is weighed by the logarithm of its
chi-squared, which holds whatever the noise is.

Where the windows tell how the joints move (:func:`skin2urdf.structure.gravity.moments`), offsets
and the accelerations by which they are felt belong to the fits; else what moves is noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.geometry.so3 import axis_rotation
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.structure.chain_fit import (
    Carried,
    GravityFits,
    fit_gravity,
    seen_beyond,
    sensor_matrix,
)
from skin2urdf.structure.gravity import GravityWindows

MISSING = 0.5
"""Share of what an SU at rest on the base would leave above noise that a chain which lacks a joint
leaves at least: 0.79 to 0.99 in 29 simulated recordings of panda, ur5 and z1 with a bare segment,
below 0.1 where none is missing."""
_STEADY = 0.2
"""What an SU may feel beside gravity of one direction where no joint turns it [m/s^2], rms: biases
drift by 20 mg while sensors warm up. A joint that turns gravity by no more moves by a degree."""


@dataclass(frozen=True, eq=False)
class Segment:
    """A rigid body whose rotation is known in all windows.

    Attributes:
        parent: index of the segment before it; -1 for the RS.
        dof: index of the joint that carries it; -1 for the RS.
        axis: (3,) the joint's axis at position zero, in the base frame.
        R: (W, 3, 3) rotation of the segment in the base frame, identity at position zero.
        omega: (3, W) its angular velocity, and
        alpha: (3, W) angular acceleration, in its own frame; zero where these are not modelled.
        columns: (c, 3, W) what a metre of each offset up to here adds to the specific force there.
        fits: how well each of the U SUs would sit on it.
        misfit: (U,) what those fits leave, as :meth:`Grown.misfit`.
    """

    parent: int
    dof: int
    axis: F64
    R: F64
    omega: F64
    alpha: F64
    columns: F64
    fits: GravityFits
    misfit: F64


class Grown:
    """Known segments, and what SUs feel on them.

    Attributes:
        windows: the measurements.
        up: (G, 3) upward unit vectors of the logs in the base frame; NaN where not known yet.
        segments: the known segments, the RS first; parents come before their children.
        weight: (W, U) inverse variances of what the fits leave [s^4/m^2].
        rough: (W, U) those of readings as gravity alone, by which axes are ranked whatever is
            modelled when they are fitted.
        n: (U,) measurements.

    Args:
        windows: the measurements.
        up: upward unit vectors, as above.
        known: parent, joint and axis of each segment that is known beyond the RS.
    """

    def __init__(
        self, windows: GravityWindows, up: F64, known: Sequence[tuple[int, int, F64]] = ()
    ) -> None:
        self.windows = windows
        self.up = up
        self.segments: list[Segment] = []
        usable = np.asarray(np.isfinite(up).all(axis=1))[windows.log]
        self.rough = windows.weight * usable[:, None]
        self.weight = self.rough
        if windows.moving is not None:
            self.weight = usable[:, None] / windows.moving.sd**2
        self._upward = np.where(usable[:, None], up[windows.log], 0.0) * GRAVITY
        self.n = 3.0 * (self.weight > 0).sum(axis=0)
        self.add(-1, -1, np.zeros(3))
        for parent, dof, axis in known:
            self.add(parent, dof, axis)

    def add(self, parent: int, dof: int, axis: F64) -> None:
        """Add the segment that a joint about an axis (3,) carries beyond a known one."""
        W, U = self.windows.sd.shape
        R = np.tile(np.eye(3), (W, 1, 1))
        omega, alpha, columns = np.zeros((3, W)), np.zeros((3, W)), np.zeros((0, 3, W))
        moving = self.windows.moving
        if dof >= 0:
            before, q = self.segments[parent], self.windows.q[:, dof]
            R = before.R @ axis_rotation(axis, q)
            if moving is not None:
                known = Carried(
                    before.omega[None], before.alpha[None], before.columns[None],
                    moving.qd[None, :, dof, None].swapaxes(1, 2),
                    moving.qdd[None, :, dof, None].swapaxes(1, 2), np.zeros((1, 3, W)),
                ).beyond(0, axis[None], seen_beyond(axis[None], q[None]))  # fmt: skip
                omega, alpha, columns = known.omega[0], known.alpha[0], known.columns[0]
        carried, none = None, np.zeros((U, 0, W))
        if moving is not None:
            carried = Carried(
                np.broadcast_to(omega, (U, 3, W)),
                np.broadcast_to(alpha, (U, 3, W)),
                np.broadcast_to(columns, (U, *columns.shape)),
                none,
                none,
                np.ascontiguousarray(moving.change.transpose(1, 2, 0)),
            )
        x = np.broadcast_to(self.gravity(R).T, (U, 3, W))
        y = np.ascontiguousarray(self.windows.reading.transpose(1, 2, 0))
        weight, rough = (np.ascontiguousarray(w.T) for w in (self.weight, self.rough))
        fits = fit_gravity(none, x, y, weight, none[..., :3], carried=carried, rough=rough)
        misfit = self.misfit(fits.chi2)
        self.segments.append(Segment(parent, dof, axis, R, omega, alpha, columns, fits, misfit))

    @property
    def placed(self) -> set[int]:
        """Joints that are in the tree."""
        return {s.dof for s in self.segments[1:]}

    def gravity(self, R: F64) -> F64:
        """(W, 3) upward gravity in the frame of a segment [m/s^2]."""
        return np.asarray((np.swapaxes(R, 1, 2) @ self._upward[..., None])[..., 0])

    def is_steady(self, segment: Segment) -> bool:
        """Whether gravity points one way in a segment, so that it hides upright joints beyond."""
        felt = self.gravity(segment.R)
        return bool(np.sqrt(((felt - felt.mean(axis=0)) ** 2).mean()) <= _STEADY)

    def misfit(self, chi2: F64, sus: Int | slice = slice(None)) -> F64:
        """Half the logarithm of chi-squared per measurement, summed over the measurements.

        A log-likelihood whose noise is no less than stated and else unknown.
        """
        n = np.maximum(self.n[sus], 1.0)
        return np.asarray(n / 2 * np.log1p(chi2 / n))

    def noise(self) -> F64:
        """(U,) misfit that noise as stated stays below in all but one of a million cases."""
        return self.misfit(self.n + 5 * np.sqrt(2 * self.n))

    def best(self) -> tuple[Int, F64]:
        """(U,) segment that suits each SU best, and (U,) what it leaves.

        Of segments that suit as well the one with fewest joints is taken; of what a sensor at rest
        on the base drifts by some joint explains a part, which is no reason for it to sit there.
        """
        misfit = np.array([s.misfit for s in self.segments])
        depth = np.array([len(self.chain(i)) for i in range(len(self.segments))])
        lowest = misfit.min(axis=0)
        # An SU further out has no more parameters; the joint itself was paid for.
        alike = misfit < lowest + 0.5
        at = np.where(alike, depth[:, None], len(depth)).argmin(axis=0)
        on_base = self._is_steady() & ~self._lacks_none(lowest)
        lowest = np.where(on_base, misfit[0], lowest)
        return np.where(on_base, 0, at).astype(np.int64), lowest

    def explained(self) -> Bool:
        """(U,) True for SUs of which no joint is missing between them and the RS."""
        at, left = self.best()
        return np.asarray(self._lacks_none(left) | (self._is_steady() & (at == 0)))

    def _lacks_none(self, left: F64) -> Bool:
        """(U,) whether chains that leave so much of SUs lack no joint."""
        noise = self.noise()
        return np.asarray(left <= noise + MISSING * np.maximum(self.segments[0].misfit - noise, 0))

    def _is_steady(self) -> Bool:
        """(U,) whether SUs feel gravity from one direction but for what sensors drift by."""
        return np.asarray(self._rms(self.segments[0].misfit) <= _STEADY)

    def left(self) -> F64:
        """(U,) what the best segments leave of readings, rms per axis [m/s^2]; NaN where none."""
        return self._rms(self.best()[1])

    def _rms(self, misfit: F64) -> F64:
        """(U,) what misfits are in readings, per axis [m/s^2]; NaN where there are none."""
        n = np.where(self.n > 0, self.n, np.nan)
        chi2 = n * np.expm1(2 * misfit / n)
        return np.asarray(np.sqrt(chi2 / (3.0 * self.weight.sum(axis=0))))

    def chain(self, segment: int) -> tuple[int, ...]:
        """Segments from the first moving one to the given one."""
        path: list[int] = []
        while segment > 0:
            path.append(segment)
            segment = self.segments[segment].parent
        return tuple(reversed(path))

    def felt_elsewhere(self, su: int) -> F64 | None:
        """(G, 3) upward unit vectors, in other logs as an SU on the newest segment feels them.

        None where it tells nothing new.
        """
        unknown = np.flatnonzero(np.isnan(self.up).any(axis=1))
        if not len(unknown):
            return None
        newest = self.segments[-1]
        bias, shape = newest.fits.sensor[su, :3], newest.fits.sensor[su, 3:]
        unbiased = (self.windows.reading[:, su] - bias)[..., None]
        felt = np.linalg.solve(sensor_matrix(shape), unbiased)
        upward = (newest.R @ newest.fits.R[su] @ felt)[..., 0]
        weight = self.windows.weight[:, su]
        up = self.up.copy()
        for g in unknown:
            mine = (self.windows.log == g) & (weight > 0)
            if mine.any():
                mean = (weight[mine, None] * upward[mine]).sum(axis=0)
                up[g] = mean / np.linalg.norm(mean)
        return None if np.array_equal(up, self.up, equal_nan=True) else up
