"""Encoders that count the other way than a model does, or from far off: found by rough fits.

From so far off no fit of all samples finds its way; what linear fits leave of the SUs, whatever
gravity does, tells which change of few joints is worth one. They are so free that a sense of one
joint may make little of a difference to them: where it explains all SUs, placing them anew tells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.trajectory.blueprint import Blueprint
from skin2urdf.estimation.uncertainty.plausible import are_plausible
from skin2urdf.geometry.se3 import screw
from skin2urdf.vendor.deviating import FEW, LOOKED_AT, with_zeros
from skin2urdf.vendor.explained import Explained
from skin2urdf.vendor.fitting import Bench
from skin2urdf.vendor.placing import Placed, place_sus, roughly_left
from skin2urdf.vendor.rigid import NOISE

_ZEROS = np.deg2rad([-150, -120, -90, -60, -30, 30, 60, 90, 120, 150, 180])
"""Zeros that are tried [rad]; from a sixth of a turn away the fit finds the right one."""
_FLOOR = 0.005**2
"""Mean square below which it does not matter how little a rough fit leaves [m^2/s^4]."""
_GAIN = 0.3
"""Drop of the mean logarithm of what rough fits leave that is worth a closer look."""


class _Change(NamedTuple):
    """Another zero of a joint, or (None) its other sense."""

    joint: int
    zero: float | None


class Counted(NamedTuple):
    """Encoders that count otherwise.

    Attributes:
        senses: joints that count the other way.
        found: the fit with them turned, and with zeros anywhere that were changed.
        alike: joints of which another change in place of the last one explains as much.
    """

    senses: tuple[str, ...]
    found: Explained
    alike: tuple[str, ...]


def count_otherwise(kept: Explained, common: Blueprint) -> Counted | None:
    """The model with other senses and zeros of few joints, found by what rough fits leave.

    Of changes that explain all, a sense comes before a zero, which has a number to choose: the one
    of a joint between two axes that are parallel at its zero is the other's half turn.

    Args:
        kept: the model as it is.
        common: the same with what is common allowed for.

    Returns:
        What was changed; None where no change is worth a look.
    """
    bench = kept.bench
    changes: list[_Change] = []
    found: Explained | None = None
    alike: list[int] = []
    least = _rough(bench, changes)
    sense = _placed_sense(kept)
    for _ in range(FEW):
        known = {change.joint for change in changes}
        some = [
            _Change(j, zero)
            for j in _moved(bench)
            if j not in known
            for zero in (None, *([] if bench.chassis.joint_types[j] == "prismatic" else _ZEROS))
        ]
        if not some:
            break
        scores = [_rough(bench, [*changes, change]) for change in some]
        best = [int(i) for i in np.argsort(scores)[:LOOKED_AT] if scores[i] < least - _GAIN]
        if not changes and sense is not None and (i := some.index(sense)) not in best:
            best.append(i)
        if not best:
            break
        tried = {i: _followed(kept, common, [*changes, some[i]]) for i in best}
        i = min(tried, key=lambda k: _order(tried[k]))
        found, least = tried[i], scores[i]
        changes.append(some[i])
        if found.fits:
            alike = [some[k].joint for k in tried if k != i and tried[k].fits]
            break
    if found is None:
        return None
    names = [joint.name for joint in bench.chassis.joints]
    senses = tuple(names[change.joint] for change in changes if change.zero is None)
    return Counted(senses, found, tuple(dict.fromkeys(names[j] for j in alike)))


def _placed_sense(kept: Explained) -> _Change | None:
    """The joint whose other sense lets all SUs be placed that were not; None where none does.

    What not even the free numbers of rough fits explain no placement does.
    """
    bench, sensors = kept.bench, kept.bench.settings.estimation.priors
    T = bench.chassis.T_parent_joint
    best, least = None, _left(kept.placed)
    for j in _moved(bench):
        change = _Change(j, None)
        there = _with_senses(bench, [change])
        if roughly_left(bench.chassis, T, there.logs).max() > NOISE**2:
            continue
        left = _left(place_sus(bench.chassis, there.logs, sensors))
        if left < min(least, NOISE):
            best, least = change, left
    return best


def _left(placed: Placed) -> float:
    """What is left of the SU that fits worst [m/s^2]; infinite with a sensor that can not be."""
    possible = are_plausible(placed.state(np.zeros((0, 4, 4))))
    return float(placed.left.max()) if possible.all() else float("inf")


def _order(found: Explained) -> tuple[bool, int, float]:
    """What fits comes first, and of that what has fewer zeros."""
    return not found.fits, len(found.offsets) if found.fits else 0, found.left.mean


def _rough(bench: Bench, changes: Sequence[_Change]) -> float:
    """Mean logarithm of what rough fits leave of the SUs."""
    there = _with_senses(bench, changes)
    T = _with_given_zeros(bench.chassis.T_parent_joint, changes)
    return float(np.log(roughly_left(bench.chassis, T, there.logs) + _FLOOR).mean())


def _followed(kept: Explained, common: Blueprint, changes: Sequence[_Change]) -> Explained:
    """The fit that changes lead to."""
    bench = _with_senses(kept.bench, changes)
    T = _with_given_zeros(bench.chassis.T_parent_joint, changes)
    sensors = bench.settings.estimation.priors
    shifted = replace(bench, chassis=replace(bench.chassis, T_parent_joint=T))
    # The mount that was found may be what made up for the wrong model.
    placed = place_sus(shifted.chassis, bench.logs, sensors)
    begin = replace(common, T_parent_joint=T)
    first = replace(
        kept, bench=bench, placed=placed, blueprint=begin,
        along=shifted.fit(placed, begin, sensors),
    )  # fmt: skip
    wide = [change.joint for change in changes if change.zero is not None]
    if not wide:
        return first
    return with_zeros(replace(kept, bench=bench, blueprint=common), wide, first)


def _with_senses(bench: Bench, changes: Sequence[_Change]) -> Bench:
    """The same with joints counted the other way."""
    sign = np.ones(bench.chassis.n_joints)
    sign[[change.joint for change in changes if change.zero is None]] = -1.0
    if (sign > 0).all():
        return bench
    return replace(bench, logs=[log.with_joints_times(sign) for log in bench.logs])


def _with_given_zeros(T_parent_joint: F64, changes: Sequence[_Change]) -> F64:
    """(D, 4, 4) placements with other zeros."""
    T = np.array(T_parent_joint)
    for joint, zero in changes:
        if zero is not None:
            T[joint] = T[joint] @ screw("z", zero, 0.0)
    return T


def _moved(bench: Bench) -> list[int]:
    """Joints that move in some log."""
    moves = np.any([log.moving.any(axis=0) for log in bench.logs], axis=0)
    return [int(j) for j in np.flatnonzero(moves)]
