"""Something touched the robot: those moments are named and left out."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.calibration.clock import Clock, Tell
from skin2urdf.calibration.rounds import Logs, Solution, is_hopeless, predicted_curvature
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.faults import Fault
from skin2urdf.hypotheses.attempts import Search
from skin2urdf.hypotheses.records import Amendment, Attempt, Candidate
from skin2urdf.model.prediction import Chains
from skin2urdf.signals.contact import Disturbance, disturbances, without
from skin2urdf.signals.records import Features
from skin2urdf.signals.sampling import Sampled

_MOST_LEFT = 0.7
"""Share of the residuals that a joint's motion leaves at most where it is their cause."""
_ROUGH = 0.1
"""Relative error of what a hit does to a reading at first order."""
_NUMBERS = 3
"""What a hit is told by: when it begins and ends, and how hard it is."""


@dataclass(frozen=True, eq=False)
class LeftOut(Amendment):
    """Moments that are left out of the logs.

    Attributes:
        moments: in which something touched the robot.
        pushed: the joint of the tree that moved in each of them.
    """

    moments: tuple[Disturbance, ...]
    pushed: tuple[int, ...]

    @property
    def key(self) -> Hashable:
        """All moments are left out together."""
        return "left out"

    @property
    def parameters(self) -> int:
        """Those of every moment."""
        return _NUMBERS * len(self.moments)

    @property
    def apart(self) -> float:
        """Residuals that stand out, over their deviations: no feature counts those."""
        return sum(d.strength**2 for d in self.moments)

    def left_out(self, logs: Logs) -> Logs:
        """The logs without these moments."""
        return logs.of(without(logs.sampled, self.moments))


class Contact:
    """Something touched the robot: in those moments readings do not follow the joints' motion."""

    rank: Literal[0, 1, 2] = 0

    def propose(self, search: Search, now: Attempt | None) -> Sequence[Candidate]:
        """All moments that stand out; a large one may hide a small one, which is seen next.

        What no estimate explains says nothing of what lies beyond first order. Joints that cross
        the slack of their gears jump as if they were hit: where all samples tell how large that is,
        no moment counts that it explains.
        """
        if now is None or is_hopeless(now.solution.found):
            return []
        found, features = now.solution.found, now.solution.features
        seen = _disturbed(now.solution.logs.sampled, now.solution, search.clock)
        of_logs = search.plain.sampled
        seen = [each for each in seen if search.stands_out(*_when(each[0], of_logs))]
        new = [d for d, _ in seen]
        if not new:
            return []
        old = [a for a in now.amendments if isinstance(a, LeftOut)]
        moments = tuple(d for a in old for d in a.moments) + tuple(new)
        pushed = tuple(j for a in old for j in a.pushed) + tuple(j for _, j in seen)
        column = {name: u for u, name in enumerate(found.tree.su_names)}
        blocks = {
            (d.pose, column[features.su_names[u]])
            for d in new for u in d.felt if features.su_names[u] in column
        }  # fmt: skip
        left = sum(max(0.0, found.chi2_by_block[b] - found.count[b]) for b in blocks)
        return [
            Candidate(
                "contact", tuple(f"{d.log}:{d.time:.3f}" for d in new), (LeftOut(moments, pushed),),
                float(left),
            )
        ]  # fmt: skip

    def findings(self, last: Attempt) -> Sequence[Fault]:
        """What hit the robot, and which joint."""
        names, joints = last.solution.features.su_names, last.solution.found.tree.joint_names
        return [
            _fault(d, joints[joint], names, last.whole.sampled)
            for a in last.amendments if isinstance(a, LeftOut)
            for d, joint in zip(a.moments, a.pushed, strict=True)
        ]  # fmt: skip

    def finish(self, last: Attempt, clock: Clock) -> Attempt:
        """The moments as an estimate sees them that does not know them."""
        if not any(isinstance(a, LeftOut) for a in last.amendments):
            return last
        seen = _disturbed(last.whole.sampled, last.solution, clock)
        new = LeftOut(tuple(d for d, _ in seen), tuple(joint for _, joint in seen))
        others = (a for a in last.amendments if not isinstance(a, LeftOut))
        return replace(last, amendments=(*others, new))


def _disturbed(
    sampled: Sequence[Sampled], solution: Solution, clock: Clock
) -> list[tuple[Disturbance, int]]:
    """Moments in logs that stand out from what a solution explains, and the joint that was pushed.

    What one SU feels alone, with others on its way from the base, happened to that SU.
    """
    found, features = solution.found, solution.features

    def look(tell: Tell) -> list[tuple[Disturbance, int]]:
        curvature = predicted_curvature(found, features)
        out = []
        for d in disturbances(sampled, features, curvature, progress=tell):
            joint, left = pushed_joint(d, found, features)
            if left < _MOST_LEFT:
                out.append((d, joint))
        return out

    return clock.run("hits", look)


def pushed_joint(touched: Disturbance, found: Estimate, features: Features) -> tuple[int, float]:
    """The joint whose motion, unseen by its encoder, explains a disturbance best.

    A joint d that moves by b(t) changes every reading by ``s_d b(t) + tau_d b''(t)``. At each
    moment that is a linear problem in b and its acceleration, in the noise of the SUs and of the
    other encoders. Of SUs that a hit may take beyond their range it only counts that they feel it.

    Args:
        touched: residuals of the features' SUs.
        found: an estimate; its tree may have fewer SUs and joints.
        features: what the residuals are of.

    Returns:
        Its index in the tree, and the share of the residuals that its motion leaves.
    """
    tree, chains = found.tree, found.cost.blocks.chains
    column = [features.su_names.index(name) for name in tree.su_names]
    dof = [features.dof_names.index(name) for name in tree.joint_names]
    rows = found.cost.at(found.state).kin.features()[touched.pose]
    effects = np.stack([_effects(rows, chains, j) for j in range(tree.n_joints)])
    encoders = effects[..., 1] * touched.encoder_noise[dof, None, None]
    residual = touched.residual[:, column]
    size = np.linalg.norm(residual, axis=-1)
    left: list[float] = []
    for j in range(tree.n_joints):
        beyond = effects[j].any(axis=(1, 2))
        rough = np.where(touched.cut_off[column] & beyond, 1.0, _ROUGH)
        noise = np.hypot(touched.noise[column], rough * size)
        left.append(unexplained(residual, noise, encoders, effects[j]))
    best = int(np.argmin(left))
    noise = np.hypot(touched.noise[column], _ROUGH * size)
    whole = unexplained(residual, noise, encoders, np.zeros_like(effects[0]))
    return best, left[best] / max(whole, 1e-12)


def _effects(rows: F64, chains: Chains, j: int) -> F64:
    """(U, 3, 2) change of all readings with position and acceleration of joint j."""
    U, L = chains.joint.shape
    effects = np.zeros((U, 3, 2))
    for u, i in zip(*np.nonzero((chains.joint == j) & chains.present), strict=True):
        effects[u, :, 0], effects[u, :, 1] = rows[u, 1 + i], rows[u, 1 + L + i]
    return effects


def unexplained(y: F64, noise: F64, shared: F64, effects: F64) -> float:
    """Weighted sum of squares that two effects leave of N moments.

    Args:
        y: (N, U, 3) readings [m/s^2].
        noise: (N, U) standard deviation per axis of each of them [m/s^2].
        shared: (J, U, 3) what each of J independent noises of variance 1 adds to all [m/s^2].
        effects: (U, 3, 2) the effects, of any size at each moment.
    """
    N = len(y)
    weight = np.repeat(1 / noise**2, 3, axis=1)
    flat, S = y.reshape(N, -1, 1), shared.reshape(len(shared), -1)
    columns = np.broadcast_to(effects.reshape(1, -1, 2), (N, flat.shape[1], 2))
    both = np.concatenate([flat, columns], axis=2)
    weighted = weight[..., None] * both
    among = np.eye(len(S)) + (S * weight[:, None]) @ S.T
    seen = S @ weighted
    # Products in the inverse of the noise's covariance, by Woodbury's identity.
    Q = both.swapaxes(1, 2) @ weighted - seen.swapaxes(1, 2) @ np.linalg.solve(among, seen)
    explained = Q[:, :1, 1:] @ np.linalg.pinv(Q[:, 1:, 1:], hermitian=True) @ Q[:, 1:, :1]
    return float((Q[:, 0, 0] - explained[:, 0, 0]).sum())


def _fault(
    touched: Disturbance, joint: str, su_names: tuple[str, ...], sampled: Sequence[Sampled]
) -> Fault:
    """A disturbance of a log as a fault of the joint that was pushed."""
    log, begin, end = _when(touched, sampled)
    return Fault(
        "contact", joint, log=log, begin=begin, end=end, size=touched.strength,
        sus=tuple(su_names[u] for u in touched.felt),
    )  # fmt: skip


def _when(touched: Disturbance, sampled: Sequence[Sampled]) -> tuple[int, float, float]:
    """The log of a disturbance, its begin and its end [s]."""
    time = sampled[touched.log].motion.grid.time
    return touched.log, float(time[touched.begin]), float(time[touched.end - 1])
