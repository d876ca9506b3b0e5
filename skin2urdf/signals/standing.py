"""Whether what carries all SUs stands still while no joint moves.

As long as no joint moves, a robot is one rigid body, and gravity keeps its direction in all SUs. If
the body turns, gravity turns by the same angle in each, however it is mounted: an SU that slips, or
biases that drift turn it by other angles, or in some SUs alone. Joints that creep to their rest
turn what is beyond them, and may turn most SUs alike: by no more than they move.

A base that drives, lifts or turns about a vertical axis turns gravity in no SU, and adds to what
each feels, by other amounts at other places. That shows at the times when it speeds up or brakes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.signals.poses import Rest

_PIECE = 0.5
"""Length [s] over which readings are averaged: what rings after a move has several periods in it,
and a base that sways or drives turns in it by an angle that shows."""
_ALONE = 0.1
"""Time [s] in which noise of readings at rest, rounding and vibration repeat themselves at most."""
_CERTAIN = 5.0
"""Standard deviations from which an angle is none by chance."""
_LEAST = 2e-3
"""Angle [rad] by which nothing that stands turns: what a floor does under people, and biases in
seconds, is less, and lengths feel less of it than of gravity's own deviation. Over gravity it is
also the change of what is felt that is no more than that."""
_ALIKE = 0.2
"""Part of the angle by which SUs may differ: gravity is longer or shorter by what bases accelerate.
"""
_MOST = 0.75
"""Share of the SUs that have to turn alike, or to feel a change: some may be loose, or drift."""


@dataclass(frozen=True)
class AtRest:
    """What changes from one half second to the next while no joint moves; 0 where nothing does.

    Attributes:
        angle: by which all SUs turn alike, rms over rests [rad]; 0 where most pairs of half seconds
            do not show any, as a base that moves at times only has it.
        change: of what three SUs of four feel at least, rms over the pairs that show any [m/s^2].
            Where a base drives or turns, SUs at other places feel other changes.
    """

    angle: float
    change: float


def changes_at_rest(
    rests: Sequence[Rest], readings: F64, valid: Bool, q: F64, rate: float
) -> AtRest:
    """Compare half seconds of readings in which no joint moves with those before them.

    Args:
        rests: where no joint moves; moments that only stand for rests do not count.
        readings: (N, U, 3) readings on the grid [m/s^2].
        valid: (N, U) where they are whole.
        q: (N, D) joint positions, which may creep to their rest [rad or m].
        rate: of the grid [Hz].

    Returns:
        Nothing that chance, or joints that creep, may have made; nothing where no rest lasts two
        such pieces.
    """
    size = max(2, round(_PIECE * rate))
    angles, changes = [np.zeros(0)], [np.zeros(0)]
    for rest in rests:
        pieces = (rest.end - rest.begin) // size if rest.still else 0
        first = rest.begin + size * np.arange(pieces)
        heard = np.flatnonzero(valid[rest.begin : rest.begin + pieces * size].all(axis=0))
        if pieces > 1 and len(heard) > 1:
            # One after the other: a rest may be as long as a log of a thousand SUs.
            seen = [_seen(readings[k : k + size][:, heard], rate) for k in first.tolist()]
            mean, sd = np.stack([m for m, _ in seen]), np.stack([d for _, d in seen])
            where = np.stack([q[k : k + size].mean(axis=0) for k in first.tolist()])
            # No SU is turned by more than all joints together; one that slides counts as if it did.
            crept = np.abs(np.diff(where, axis=0)).sum(axis=1)
            angles.append(_turned(mean, sd, crept))
            changes.append(_changed(mean, sd, crept))
    angle, change = np.concatenate(angles), np.concatenate(changes)
    most = 2 * np.count_nonzero(angle) > len(angle)
    return AtRest(_rms(angle) if most else 0.0, _rms(change))


def _rms(x: F64) -> float:
    """Of those that are not 0; 0 without any."""
    shown = x[x > 0.0]
    return float(np.sqrt(np.mean(shown**2))) if len(shown) else 0.0


def _seen(x: F64, rate: float) -> tuple[F64, F64]:
    """Mean (U, 3) of a piece of readings (n, U, 3) [m/s^2], and deviation of its direction (U,)."""
    mean = x.mean(axis=0)
    # What turns on and on in a piece is none of its noise.
    along = np.linspace(-1.0, 1.0, len(x))
    slope = np.tensordot(along, x, 1) / (along @ along)
    noise = (x - mean - along[:, None, None] * slope).std(axis=0).max(axis=1)
    alone = np.sqrt(max(1.0, _ALONE * rate) / len(x))
    return mean, noise * alone / np.maximum(np.linalg.norm(mean, axis=1), noise.clip(1e-12))


def _turned(mean: F64, sd: F64, crept: F64) -> F64:
    """(P - 1,) angle between neighbours of P pieces [rad]; 0 where it is none.

    Args:
        mean: (P, U, 3) readings of each, and
        sd: (P, U) deviations of their directions [rad].
        crept: (P - 1,) by how much all joints together moved [rad or m].
    """
    across = np.linalg.norm(np.cross(mean[1:], mean[:-1]), axis=2)
    angle = np.arctan2(across, np.einsum("pui,pui->pu", mean[1:], mean[:-1]))
    common = np.median(angle, axis=1)
    off = np.hypot(sd[1:], sd[:-1])
    alike = np.abs(angle - common[:, None]) < _CERTAIN * off + _ALIKE * common[:, None]
    certain = common > np.maximum(_CERTAIN * np.median(off, axis=1), _LEAST) + crept
    return np.where(certain & (alike.mean(axis=1) >= _MOST), common, 0.0)


def _changed(mean: F64, sd: F64, crept: F64) -> F64:
    """(P - 1,) change of what SUs feel between neighbours of P pieces [m/s^2]; 0 for none.

    Args:
        mean: (P, U, 3) readings of each, and
        sd: (P, U) deviations of their directions [rad].
        crept: (P - 1,) by how much all joints together moved [rad or m].
    """
    change = np.linalg.norm(np.diff(mean, axis=0), axis=2)
    off = sd * np.linalg.norm(mean, axis=2)
    least = np.maximum(_CERTAIN * np.hypot(off[1:], off[:-1]), _LEAST * GRAVITY)
    certain = change > least + GRAVITY * crept[:, None]
    return np.where(certain.mean(axis=1) >= _MOST, np.median(change, axis=1), 0.0)
