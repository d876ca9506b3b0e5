"""Gravity as SUs feel it at rest and in slow motion, and chains of joints that explain it.

No patterns and no moves of single joints are asked for: a reading averaged over a rest, or over a
moment of a move, is gravity seen in the SU's frame, off by what accelerations can make of it::

    y = (I + S) R^T Rot(k_m, -q_m) .. Rot(k_1, -q_1) x + b

with x the upward gravity in the frame of a segment whose motion is known, k the axes of the
joints beyond it, R the SU's orientation on the last one, and S, b its scale, cross-axis and bias.

A robot that hardly rests is felt to accelerate in every moment. That is no noise: once the axes are
known it is linear in the offsets l that the segments carry, and x becomes

    x + sum_i (skew(alpha_i) + skew(omega_i)^2) l_i

with the segments' motion in the frame that x is given in. :func:`moments` are samples for that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from skin2urdf.arrays import F64, Bool, Int, Record
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.signals.encoder_noise import EncoderNoise
from skin2urdf.signals.filters import (
    eroded,
    filtered,
    first_derivative,
    low_pass,
    second_derivative,
)
from skin2urdf.signals.information import Information
from skin2urdf.signals.records import Features
from skin2urdf.signals.sampling import Sampled, static_moves
from skin2urdf.structure.chain_fit import LEVER

_STEADY = 0.02
"""Standard deviation [m/s^2] of gravity at rest that no average takes away: 2 mg, by which the
bias of MEMS sensors wanders within minutes, and which 2 mrad of play in joints make. A joint that
turns by less has no place that gravity shows."""
_LAG = 0.03
"""Standard deviation [s] of what the SUs' clocks, buses and filters lag the joints'."""
_WINDOW = 0.2
"""Length of a moment of a move [s]: readings averaged over it hold nothing above 2 Hz."""
_SLOW = 2.5
"""Cutoff [Hz] of the joints' motion from which accelerations in such a window are judged: what an
encoder rounds is differentiated no further than that."""
_SMOOTH = 4.0
"""Low-pass [Hz] of readings and joints in moments whose accelerations are modelled: moves from pose
to pose hold little beyond, and an encoder's rounding is differentiated no further than that."""
_DIRECTION = 0.01
"""Error of directions [rad] with which accelerations are modelled while a tree grows: axes are
fitted to half a degree. What is taken for noise hides joints whose axes lie close to each other."""
OFF_IN_TIME = 0.05
"""Part of accelerations that an SU may be off by whose clock drifts or whose axes are bent."""
_BEYOND = 2.0
"""Times the cutoff of that low-pass up to which its loss is looked at: motion that it cuts off
reaches little further, and sensors' noise does."""
_MOST_MOMENTS = 240
"""Moments that a tree is grown from: one in 0.75 s of a log of three minutes, and joints turn by
half a radian in between."""
_MOST_WINDOWS = 120
"""Windows looked at; the rest of a long log would only repeat what the steadiest ones say."""


@dataclass(frozen=True, eq=False)
class Moving(Record):
    """How joints and readings change in W moments.

    Attributes:
        qd: (W, D) velocities of the joints, and
        qdd: (W, D) accelerations.
        change: (W, U, 3) derivatives of the readings [m/s^3].
        sd: (W, U) what readings may be off by once accelerations are modelled, per axis [m/s^2].
    """

    qd: F64
    qdd: F64
    change: F64
    sd: F64


@dataclass(frozen=True, eq=False)
class GravityWindows(Record):
    """Readings of gravity in W windows of rest or slow motion.

    Attributes:
        dof_names: D DoF names.
        su_names: U SU names.
        q: (W, D) mean joint positions [rad or m].
        log: (W,) index of the log, or of the span of time in which gravity has one direction.
        reading: (W, U, 3) mean readings [m/s^2]; 0 where an SU was not heard.
        sd: (W, U) what gravity's share of them may be off by, per axis [m/s^2]; infinite where an
            SU was not heard.
        moving: how the joints moved, where accelerations are to be modelled; None where they are
            part of ``sd``.
    """

    dof_names: tuple[str, ...]
    su_names: tuple[str, ...]
    q: F64
    log: Int
    reading: F64
    sd: F64
    moving: Moving | None = None

    @property
    def weight(self) -> F64:
        """(W, U) inverse variances [s^4/m^2]; 0 where an SU was not heard."""
        return np.asarray(1.0 / self.sd**2)

    @property
    def may_show(self) -> Bool:
        """(D,) True for joints that can turn gravity by more than no average takes away."""
        if not len(self.q):
            return np.zeros(len(self.dof_names), dtype=bool)
        return np.asarray(np.ptp(self.q, axis=0) * GRAVITY > _STEADY)

    def pushed_by(self, sliding: Sequence[int]) -> GravityWindows:
        """The windows with what some joints push by as noise, where accelerations are modelled.

        In its own direction a slide pushes all beyond it by as much as it accelerates [m/s^2].

        Args:
            sliding: numbers of the joints that slide.
        """
        if self.moving is None or not sliding:
            return self
        push = np.abs(self.moving.qdd[:, list(sliding)]).sum(axis=1)
        sd = np.hypot(self.moving.sd, push[:, None])
        return replace(self, moving=replace(self.moving, sd=sd))

    def some(self, which: Int) -> GravityWindows:
        """Only some of the windows."""
        return GravityWindows(
            self.dof_names, self.su_names, self.q[which], self.log[which], self.reading[which],
            self.sd[which],
        )  # fmt: skip


def gravity_windows(
    sampled: Sequence[Sampled],
    su_names: Sequence[str],
    spans: Sequence[Int] = (),
    *,
    most: int = _MOST_WINDOWS,
) -> GravityWindows:
    """Windows of all logs in which readings are mostly gravity, the steadiest ones.

    Args:
        sampled: the logs on their grids, with the same joints and SUs.
        su_names: U SU names.
        spans: per log (N,) number of the span of time of each sample of its grid, which stands for
            that of the log where gravity has its own direction in each; () for logs as they are.
        most: number of windows kept at most.
    """
    q, log, reading, variance = [], [], [], []
    for g, s in enumerate(sampled):
        rate = s.motion.grid.rate
        smooth = filtered(s.motion.q, low_pass(_SLOW, rate))
        qd, qdd = first_derivative(smooth, rate), second_derivative(smooth, rate)
        for begin, end, rests in _intervals(s):
            n = end - begin
            part = slice(begin, end)
            valid = s.valid[part].mean(axis=0) > 0.5
            weights = s.valid[part, :, None] / np.maximum(s.valid[part].sum(0), 1)[:, None]
            mean = (s.readings[part] * weights).sum(axis=0)
            spread = ((s.readings[part] - mean) ** 2 * weights).sum(axis=(0, 2)) / 3
            seconds = n / rate
            speed = np.abs(qd[part]).sum(axis=1)
            acceleration = np.abs(qdd[part]).sum(axis=1)
            if rests:
                # What rings or shakes averages out over its periods, half a second at most.
                error = spread / (1 + 2 * seconds)
            else:
                felt = LEVER * float((acceleration + speed**2).mean())
                turning = np.linalg.norm(s.readings[end - 1] - s.readings[begin], axis=-1) / seconds
                error = felt**2 + (_LAG * turning) ** 2
            q.append(s.motion.q[part].mean(axis=0))
            log.append(int(spans[g][(begin + end) // 2]) if spans else g)
            reading.append(np.where(valid[:, None], mean, 0.0))
            variance.append(np.where(valid, error + _STEADY**2, np.inf))
    D, U = sampled[0].motion.q.shape[1], len(su_names)
    windows = GravityWindows(
        sampled[0].motion.dof_names, tuple(su_names), np.array(q).reshape(-1, D),
        np.array(log, dtype=np.int64), np.array(reading).reshape(-1, U, 3),
        np.sqrt(np.array(variance).reshape(-1, U)),
    )  # fmt: skip
    total = windows.weight.sum(axis=1)
    heard = np.flatnonzero(total > 0)
    steadiest = heard[np.argsort(-total[heard], kind="stable")[:most]]
    return windows.some(np.sort(steadiest))


def moments(
    sampled: Sequence[Sampled],
    su_names: Sequence[str],
    spans: Sequence[Int] = (),
    *,
    most: int = _MOST_MOMENTS,
    off: float = _DIRECTION,
) -> GravityWindows:
    """Samples spread evenly over all logs, with how the joints move there.

    Args:
        sampled: the logs on their grids, with the same joints and SUs.
        su_names: U SU names.
        spans: as for :func:`gravity_windows`.
        most: number of samples at most.
        off: part of accelerations that their model may be off by [1].
    """
    total = sum(s.motion.grid.size for s in sampled)
    parts = []
    for g, s in enumerate(sampled):
        rate = s.motion.grid.rate
        taps = low_pass(_SMOOTH, rate)
        q, y = filtered(s.motion.q, taps), filtered(s.readings, taps)
        whole = s.valid & s.motion.valid[:, None]
        ok = np.stack([eroded(column, len(taps) // 2) for column in whole.T], axis=1)
        at = np.arange(0, len(q), max(round(_WINDOW * rate), -(-total // most)))
        qd, qdd = first_derivative(q, rate)[at], second_derivative(q, rate)[at]
        change = first_derivative(y, rate)[at]
        speed = np.abs(qd).sum(axis=1)
        felt = LEVER * (np.abs(qdd).sum(axis=1) + speed**2)
        # Of accelerations of any direction a third of the square is along gravity: what each SU
        # feels of them, which is far less near the base than what all joints could make.
        beside = np.linalg.norm(y, axis=-1) - GRAVITY
        pushed = 3 * _about(beside**2, rate)[at]
        modelled = np.sqrt(_STEADY**2 + off**2 * pushed + _cut_off(s, y)[at])
        turning = np.linalg.norm(change, axis=-1)
        rough = np.sqrt(_STEADY**2 + felt[:, None] ** 2 + (_LAG * turning) ** 2)
        sd = np.where(ok[at], rough, np.inf)
        left = np.where(ok[at], modelled, np.inf)
        reading = np.where(ok[at, :, None], y[at], 0.0)
        of_log = spans[g][at] if spans else np.full(len(at), g)
        parts.append((q[at], of_log, reading, sd, qd, qdd, change, left))
    q, log, reading, sd, qd, qdd, change, left = (
        np.concatenate([p[i] for p in parts]) for i in range(8)
    )
    names = sampled[0].motion.dof_names
    moving = Moving(qd, qdd, change, left)
    return GravityWindows(names, tuple(su_names), q, log, reading, sd, moving)


def _cut_off(s: Sampled, smooth: F64) -> F64:
    """(N, U) mean square per axis of what a low-pass took of readings near a sample [m^2/s^4].

    Joints that move slowly enough to pass it may together turn gravity faster than that.

    Args:
        s: a log on its grid.
        smooth: (N, U, 3) its readings, low-passed.
    """
    rate = s.motion.grid.rate
    taps = low_pass(min(_BEYOND * _SMOOTH, 0.4 * rate), rate)
    lost = ((filtered(s.readings, taps) - smooth) ** 2).mean(axis=-1)
    return _about(lost, rate)


def _about(squares: F64, rate: float) -> F64:
    """(N, U) means of squares over a moment about each sample."""
    return np.asarray(uniform_filter1d(squares, max(1, round(_WINDOW * rate)), axis=0))


def _intervals(s: Sampled) -> list[tuple[int, int, bool]]:
    """Grid intervals of rests, without their ends, and of the moments in between."""
    out: list[tuple[int, int, bool]] = []
    length = max(2, round(_WINDOW * s.motion.grid.rate))
    at = 0
    for rest in (*s.rests, None):
        stop = len(s.motion.q) if rest is None else rest.begin
        out += [
            (begin, begin + length, False)
            for begin in range(at, stop - length + 1, length)
            if s.motion.valid[begin : begin + length].all()
        ]
        if rest is not None:
            trim = min(12, (rest.end - rest.begin) // 4)
            out.append((rest.begin + trim, rest.end - trim, rest.still))
            at = rest.end
    return out


def gravity_features(windows: GravityWindows, sampled: Sequence[Sampled]) -> Features:
    """The windows as features of poses without patterns: ``f0`` is all that was measured.

    Args:
        windows: the measurements.
        sampled: the logs that they come from.
    """
    W, U = windows.sd.shape
    n = 1 + 2 * len(windows.dof_names)
    coefficients = np.zeros((W, U, n, 3))
    coefficients[:, :, 0] = windows.reading
    only_gravity = np.zeros((1, n, n))
    only_gravity[0, 0, 0] = 1.0
    position_sd = np.array([np.where(s.motion.named, s.motion.noise, np.inf) for s in sampled])
    return Features(
        su_names=windows.su_names,
        dof_names=windows.dof_names,
        q=windows.q,
        log=windows.log,
        coefficients=coefficients,
        information=Information.of_products(only_gravity, np.zeros((W, U), dtype=np.int64)),
        noise=np.repeat(windows.sd[:, :, None], 3, axis=2),
        latency=np.zeros(U),
        latency_sd=np.full(U, np.inf),
        moves=static_moves(sampled),
        encoders=EncoderNoise(position_sd=position_sd[windows.log]),
    )
