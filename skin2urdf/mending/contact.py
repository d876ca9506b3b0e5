"""Something touched the robot: those moments are named and left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.estimate import Estimate
from skin2urdf.faults import Fault
from skin2urdf.mending.records import Solution
from skin2urdf.model.prediction import Chains
from skin2urdf.rounds import predicted_curvature
from skin2urdf.signals.contact import Disturbance, disturbances, without
from skin2urdf.signals.sampling import Sampled

_PASSES = 3
"""How often, at most, disturbances are looked for: a large one hides a small one."""
_MOST_LEFT = 0.7
"""Share of the residuals that a joint's motion leaves at most where it is their cause."""
_ROUGH = 0.1
"""Relative error of what a hit does to a reading at first order."""


def with_contacts_left_out(solution: Solution) -> Solution:
    """The solution without the moments in which readings do not follow the joints' motion."""
    logs = solution.rounds.sampled
    for _ in range(_PASSES):
        touched = [d for d, _ in _disturbed(solution.rounds.sampled, solution)]
        if not touched:
            break
        rounds = solution.rounds
        solution = solution.again(rounds.with_logs(without(rounds.sampled, touched)), ())
    if solution.rounds.sampled is logs:
        return solution
    # What hit the robot shows undistorted to an estimate that does not know those moments.
    names, joints = solution.features.su_names, solution.found.tree.joint_names
    faults = [
        _fault(d, joints[pushed], names, len(logs) > 1) for d, pushed in _disturbed(logs, solution)
    ]
    return replace(solution, faults=(*solution.faults, *faults))


def _disturbed(sampled: Sequence[Sampled], solution: Solution) -> list[tuple[Disturbance, int]]:
    """Moments in logs that stand out from what a solution explains, and the joint that was pushed.

    What one SU feels alone, with others on its way from the base, happened to that SU.
    """
    found, features = solution.found, solution.features
    out = []
    for d in disturbances(sampled, features, predicted_curvature(found, features)):
        joint, left = pushed_joint(d, found, features.su_names)
        if left < _MOST_LEFT:
            out.append((d, joint))
    return out


def pushed_joint(
    touched: Disturbance, found: Estimate, su_names: tuple[str, ...]
) -> tuple[int, float]:
    """The joint whose motion, unseen by its encoder, explains a disturbance best.

    A joint d that moves by b(t) changes every reading by ``s_d b(t) + tau_d b''(t)``. At each
    moment that is a linear problem in b and its acceleration. Of SUs that a hit may take beyond
    their range it only counts that they feel it.

    Args:
        touched: residuals of U SUs.
        found: an estimate; its tree may have fewer SUs.
        su_names: names of the U SUs.

    Returns:
        Its index in the tree, and the share of the residuals that its motion leaves.
    """
    tree, blocks = found.tree, found.cost.blocks
    column = np.array([su_names.index(name) for name in tree.su_names], dtype=np.int64)
    kin = found.cost.at(found.state).kin
    rows = kin.features()[touched.pose]
    # An SU that this log lacks has neither residuals nor noise.
    noise = np.maximum(touched.noise[column], 1e-6)
    residual = touched.residual[:, column]
    size = np.linalg.norm(residual, axis=-1)
    left: list[float] = []
    for j in range(tree.n_joints):
        beyond = ((blocks.chains.joint == j) & blocks.chains.present).any(axis=1)
        rough = np.where(touched.cut_off[column] & beyond, 1.0, _ROUGH)
        doubt = np.hypot(noise, rough * size)[..., None]
        effects = _effects(rows, blocks.chains, j)
        left.append(_unexplained(residual / doubt, effects / doubt[..., None]))
    best = int(np.argmin(left))
    whole = ((residual / np.hypot(noise, _ROUGH * size)[..., None]) ** 2).sum()
    return best, left[best] / max(float(whole), 1e-12)


def _effects(rows: F64, chains: Chains, j: int) -> F64:
    """(U, 3, 2) change of all readings with position and acceleration of joint j."""
    U, L = chains.joint.shape
    effects = np.zeros((U, 3, 2))
    for u, i in zip(*np.nonzero((chains.joint == j) & chains.present), strict=True):
        effects[u, :, 0], effects[u, :, 1] = rows[u, 1 + i], rows[u, 1 + L + i]
    return effects


def _unexplained(y: F64, effects: F64) -> float:
    """Sum of squares that two effects (N, U, 3, 2) leave of N moments y (N, U, 3)."""
    basis, _ = np.linalg.qr(effects.reshape(len(y), -1, 2))
    flat = y.reshape(len(y), -1, 1)
    return float(((flat - basis @ (np.swapaxes(basis, -1, -2) @ flat)) ** 2).sum())


def _fault(touched: Disturbance, joint: str, su_names: tuple[str, ...], several: bool) -> Fault:
    """A disturbance in words."""
    felt = ", ".join(su_names[u] for u in touched.felt[:4])
    more = f" and {len(touched.felt) - 4} others" if len(touched.felt) > 4 else ""
    log = f" of log {touched.log + 1}" if several else ""
    return Fault(
        "contact",
        joint,
        f"something hit or pushed the robot at {touched.time:.1f} s{log}: {joint} moved without "
        f"its encoder seeing all of it, felt by {felt}{more}; those readings are left out",
        "keep people and things away from the robot while it moves",
        tuple(su_names[u] for u in touched.felt),
    )
