"""Errors of one calibration over the covariances it states."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from montecarlo.chart import as_felt, displacement, true_robot
from montecarlo.records import BLOCKS, Block
from skin2urdf.arrays import F64
from skin2urdf.calibration.result import Calibration
from skin2urdf.estimation.problem.state import N_JOINT, Step
from skin2urdf.estimation.solve.spread import DETERMINED
from skin2urdf.estimation.trajectory.azimuth import turned
from skin2urdf.estimation.trajectory.heights import rise
from skin2urdf.estimation.uncertainty.observability import ARM
from skin2urdf.geometry.units import MILLI_G
from skin2urdf.simulation import Truth

_RANK = 1e-7
"""Eigenvalue of a correlation matrix below which its direction is taken to be without variance."""
_OPEN = 1e-5
"""Eigenvalue of a covariance, over the largest, below which its direction is taken to be open.
Rounding leaves up to 2e-6 of such directions; those that a log shows best have 5e-3."""
_OBSERVABLE = {"bias": MILLI_G, "scale": 1e-3, "latency": 2e-4}
"""Stated standard deviation up to which a quantity counts as observable: 1 mg, 0.1 %, 0.2 ms.

These are the accuracies to be reached: beyond them the calibration itself says that they are not.
"""


def blocks_of(found: Calibration, truth: Truth) -> dict[str, Block]:
    """All blocks of a calibration.

    Where priors decide, errors over stated uncertainties only tell whether the simulated sensors
    are as the priors say. So orientation, bias, scale and cross-axis errors are those of SUs whose
    sensor the log determines (not on the base or on a first joint). What is stated of orientations
    allows for rotations that cross-axis errors hide, of which the same holds: sensors without any
    are better than that, and their orientations as they are felt are held against what the log
    shows alone.

    Raises:
        ValueError: its tree is not the true one.
    """
    estimate, seen, features = found.estimate, found.observability, found.features
    assert features is not None  # noqa: S101 - the recordings have poses
    tree = estimate.tree
    true = true_robot(truth, tree)
    off, felt = (
        _as_it_stands(displacement(estimate.state, tree, robot), found)
        for robot in (true, as_felt(true))
    )
    parts: dict[str, list[Block]] = {name: [] for name in BLOCKS}

    free = estimate.free.joints.ravel()
    size = free.size
    error = np.zeros(size)
    error[free] = without_open(
        off.joints.ravel()[free], seen.covariance.joint[:size, :size][free][:, free]
    )
    for e, C in zip(error.reshape(-1, N_JOINT), seen.joint_covariance, strict=True):
        parts["joint axis, direction"].append(normalised(e[2:], C[2:, 2:]))
        parts["joint axis, offset"].append(normalised(e[:2], C[:2, :2]))

    covariance = seen.covariance.su()
    sensors = found.along.problem.priors.sensors if found.along else estimate.cost.priors
    prior = sensors.deviations**2
    for u, (x, C) in enumerate(zip(off.sus, covariance, strict=True)):
        shown = np.eye(6) - _projection(seen.su_unobservable[u])
        placed = shown @ x[:6]
        parts["SU position"].append(normalised(placed[:3], C[:3, :3]))
        if not (np.diag(C)[6:] < DETERMINED * prior).all():
            continue
        parts["SU orientation"].append(normalised(placed[3:], C[3:6, 3:6]))
        without = C[3:6, 3:6] - seen.hidden_rotation**2 * np.eye(3)
        as_read = shown @ felt.sus[u, :6]
        parts["SU orientation, felt"].append(normalised(as_read[3:], without))
        for kind, name in enumerate(("bias", "scale", "cross-axis")):
            at = slice(6 + 3 * kind, 9 + 3 * kind)
            parts[name].append(normalised(x[at], C[at, at], _OBSERVABLE.get(name, 0.0)))

    names = features.su_names
    lag = truth.lag[[[su.name for su in truth.sus].index(name) for name in names]]
    # What was found of a clock before features were taken is no longer in their latency; where all
    # samples were fitted, it has what these found, too.
    total, deviation = np.array(features.latency), np.array(features.latency_sd)
    for clock in found.clocks[0]:
        u = names.index(clock.su)
        if found.along is None:
            total[u] += clock.latency
        else:
            total[u], deviation[u] = clock.latency, clock.latency_sd
    for e, sd in zip(total - lag, deviation, strict=True):
        if np.isfinite(sd):
            parts["latency"].append(
                normalised(np.array([e]), np.array([[sd**2]]), _OBSERVABLE["latency"])
            )
    return {name: summed(blocks) for name, blocks in parts.items()}


def _as_it_stands(off: Step, found: Calibration) -> Step:
    """Displacements to the truth, at the height on its first axis that the estimate took.

    They are turned about gravity as it is, too.
    """
    tree, state = found.estimate.tree, found.estimate.state
    joints, raised = rise(tree, state)
    far = float((joints * off.joints).sum())
    placed = np.array(off.sus)
    placed[:, :3] -= far * raised
    moved = off.joints - far * joints
    joints, swung = turned(tree, state, state.up[0])
    far = float((joints * moved).sum() / max((joints**2).sum(), 1e-300))
    carried = tree.su_joint >= 0
    placed[carried, :6] -= far * swung[carried]
    return replace(off, joints=moved - far * joints, sus=placed)


def normalised(error: F64, covariance: F64, observable: float = 0.0) -> Block:
    """An error over its covariance, along the directions that have any variance.

    Args:
        error: (n,).
        covariance: (n, n), which may be singular.
        observable: standard deviation up to which coordinates count as observable.
    """
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    known = sd > 0
    e, s = error[known], sd[known]
    lam, V = np.linalg.eigh(covariance[np.ix_(known, known)] / np.outer(s, s))
    some = lam > _RANK
    z = V[:, some].T @ (e / s)
    return Block(
        squared=float((z**2 / lam[some]).sum()),
        dimensions=int(some.sum()),
        inside=int((np.abs(e) < 2 * s).sum()),
        coordinates=int(known.sum()),
        observable=tuple(float(value) for value in e[s < observable] ** 2),
    )


def summed(blocks: Iterable[Block]) -> Block:
    """Several blocks as one."""
    blocks = tuple(blocks)
    return Block(
        sum(b.squared for b in blocks),
        sum(b.dimensions for b in blocks),
        sum(b.inside for b in blocks),
        sum(b.coordinates for b in blocks),
        tuple(value for b in blocks for value in b.observable),
    )


def without_open(error: F64, covariance: F64) -> F64:
    """An error (n,) without its part along directions in which a covariance (n, n) has no variance.

    There the log says nothing, and estimate and truth may differ by any amount.
    """
    lam, V = np.linalg.eigh(covariance)
    open_ = V[:, lam < _OPEN * lam[-1]]
    return np.asarray(error - open_ @ (open_.T @ error))


def _projection(unobservable: F64) -> F64:
    """(6, 6) projection onto directions (k, 6) whose angular part is given times an arm."""
    basis, _ = np.linalg.qr((unobservable / np.repeat([1.0, ARM], 3)).T)
    return np.asarray(basis @ basis.T)
