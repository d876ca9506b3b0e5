"""Algorithm 2 as the paper ran it (II-C): one global search per segment, from the RS outwards.

Kept for comparison and reproduction; :mod:`skin2urdf.estimation.solve.estimate` is the way to
calibrate.
The method takes gravity and peak accelerations only, knows no sensor errors and stops at the first
parameters whose error is below the stop value, so that its accuracy is that of the stop value.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.errors import InsufficientDataError, StructureError
from skin2urdf.estimation.problem.blocks import FeatureBlocks, feature_blocks
from skin2urdf.estimation.problem.cost import Cost, Priors
from skin2urdf.estimation.problem.state import State, identifiable
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.paper.model import (
    N_LINK,
    N_SU,
    error_function,
    link_transform,
    mean_gravity,
    su_transform,
)
from skin2urdf.paper.placements import placements
from skin2urdf.paper.search import SearchSettings, search
from skin2urdf.paper.training import MotionPattern, SuTraining, su_training
from skin2urdf.signals.records import Features
from skin2urdf.structure.records import KinematicTree

_ANGLES = np.array([True, False, False, True] * 2 + [True, False])
_LINK, _SU = tuple(range(N_LINK)), tuple(range(N_LINK, N_LINK + N_SU))
_FIRST_SU = _SU[2:]
_SECOND_LINK = _LINK[2:]
_FEWEST_POSES = 3


@dataclass(frozen=True)
class PaperSettings:
    """Choices of the paper's method.

    Attributes:
        pattern: amplitude A and frequency f of the motion pattern. Left open by the paper; the
            default has a peak acceleration of 2 pi rad/s^2. On measured features it sets how much
            accelerations weigh against gravity.
        last_dofs: DoFs directly before the SU that perform the pattern. The text says three
            (II-C.4), the sum of eq. 17 could be read as four.
        search: stop criteria and budget of each step.
        gravity: magnitude of gravity [m/s^2]; the training set is in g.
    """

    pattern: MotionPattern = field(default_factory=MotionPattern)
    last_dofs: int = 3
    search: SearchSettings = field(default_factory=SearchSettings)
    gravity: float = GRAVITY


@dataclass(frozen=True)
class PaperStep:
    """One progressive step (Fig. 4), a column of the paper's table of optimization steps.

    Attributes:
        su: name of the SU.
        n_dofs: number N of DoFs before it.
        n_parameters: newly estimated parameters.
        iterations: calls of the error function.
        attempts: searches made.
        seconds: wall time [s].
        e_total: e_T at the end [g^2] (eq. 14).
        converged: whether e_T is at or below the stop value.
    """

    su: str
    n_dofs: int
    n_parameters: int
    iterations: int
    attempts: int
    seconds: float
    e_total: float
    converged: bool


@dataclass(frozen=True, eq=False)
class PaperResult(Record):
    """Extended DH parameters as the search left them.

    Attributes:
        tree: the structure, D joints and U SUs.
        links: (D, 4) theta0, d, a, alpha of the transform from each joint's parent joint to
            it (eq. 5); zeros for joints on the RS, whose transform can not be found.
        sus: (U, 6) theta0, d, a, alpha, theta_acc, d_acc of each SU on its joint (eq. 5, 7); zeros
            for SUs on the RS.
        gravity: (U, G, 3) mean static gravity in reference coordinates per log [g] (eq. 16).
        steps: what each step took, in the order they were made.
        state: the same robot as a state with gravity along the base's z axis. Yaws about a
            limb's first DoF, which are arbitrary in ``links`` and ``sus`` (II-C.5), are chosen such
            that gravity has the same direction for all SUs.
    """

    tree: KinematicTree
    links: F64
    sus: F64
    gravity: F64
    steps: tuple[PaperStep, ...]
    state: State

    @property
    def converged(self) -> bool:
        """Whether every step reached the stop value."""
        return all(step.converged for step in self.steps)


def estimate_paper(
    features: Features,
    tree: KinematicTree,
    settings: PaperSettings | None = None,
    rng_seed: int = 0,
) -> PaperResult:
    """Estimate extended DH parameters by the paper's Algorithm 2.

    Args:
        features: the measurements; gravity and ``tau`` of the last DoFs are used.
        tree: revolute joints with at least one SU on every segment. Limbs share what they
            have in common; the paper's case is one serial chain.
        settings: choices.
        rng_seed: seed of everything random; the same seed gives the same result.

    Returns:
        The parameters, also where some steps did not reach the stop value.

    Raises:
        StructureError: a joint is prismatic, or a segment carries no SU.
        InsufficientDataError: an SU's gravity and accelerations were measured in too few poses.
    """
    settings = settings or PaperSettings()
    _check(tree)
    blocks = feature_blocks(features, tree)
    n_logs = int(blocks.log.max(initial=0)) + 1
    rng = np.random.default_rng(rng_seed)
    links, sus = np.zeros((tree.n_joints, N_LINK)), np.zeros((tree.n_sus, N_SU))
    gravity = np.full((tree.n_sus, n_logs, 3), np.nan)
    steps = []
    for joint in range(tree.n_joints):
        chain = tree.chain(joint)
        for nth, su in enumerate(np.flatnonzero(tree.su_joint == joint)):
            begin = time.perf_counter()
            data = _training(blocks, tree, int(su), settings)
            fixed = np.zeros(N_LINK + N_SU)
            fixed[:N_LINK] = links[joint]
            free = _free(len(chain), new_link=nth == 0)
            known = [link_transform(links[j]) for j in chain[1:-1]]
            error = error_function(data, known, free, fixed, settings.pattern, settings.gravity)
            found = search(error, error.bounds, _ANGLES[list(free)], settings.search, rng)
            full = error.parameters(found.x)
            links[joint], sus[su] = full[:N_LINK], full[N_LINK:]
            transforms = [link_transform(links[j]) for j in chain[1:]]
            gravity[su] = mean_gravity(data, transforms, su_transform(sus[su]), n_logs)
            seconds = time.perf_counter() - begin
            steps.append(
                PaperStep(
                    tree.su_names[su], len(chain), len(free), found.calls, found.attempts,
                    seconds, found.value, found.value <= settings.search.e_stop,
                )
            )  # fmt: skip
    state = placements(tree, blocks, links, sus, gravity, settings.gravity)
    return PaperResult(tree, links, sus, gravity, tuple(steps), state)


def as_estimate(result: PaperResult, features: Features, gravity: float = GRAVITY) -> Estimate:
    """The result judged like any other estimate: chi-squared against all of the features.

    Args:
        result: what the paper's method found.
        features: the measurements it was found from.
        gravity: magnitude of gravity [m/s^2].
    """
    tree = result.tree
    blocks = feature_blocks(features, tree)
    cost = Cost(tree, blocks, Priors(gravity=gravity))
    free = identifiable(tree, cost.n_logs, intrinsics=False)
    here = cost.at(result.state)
    n_parameters = int(free.joints.sum() + free.logs.sum() + free.sus.sum())
    n_parameters -= int((tree.parent < 0).sum())
    return Estimate(
        tree, result.state, here.chi2, here.chi2_by_block(), blocks.count,
        np.ones(blocks.count.shape), n_parameters, cost, free, (here.chi2,), cost.priors,
    )  # fmt: skip


def _check(tree: KinematicTree) -> None:
    """Raise where the tree is outside of what the paper's method can do (II-A.2)."""
    slides = [n for n, p in zip(tree.joint_names, tree.prismatic, strict=True) if p]
    remedy = "use the default method, which needs neither"
    if slides:
        raise StructureError(
            f"the paper's method knows revolute joints only, and {', '.join(slides)} slides",
            remedy,
            dofs=slides,
        )
    bare = [n for j, n in enumerate(tree.joint_names) if not (tree.su_joint == j).any()]
    if bare:
        raise StructureError(
            f"the paper's method needs an SU on every segment; none on that of {', '.join(bare)}",
            remedy,
            dofs=bare,
        )


def _training(
    blocks: FeatureBlocks, tree: KinematicTree, su: int, settings: PaperSettings
) -> SuTraining:
    data = su_training(blocks, su, settings.pattern, settings.last_dofs, settings.gravity)
    if data.n_poses < _FEWEST_POSES:
        raise InsufficientDataError(
            f"{tree.su_names[su]}: gravity and the accelerations by its last "
            f"{data.acceleration.shape[1]} DoFs were measured together in {data.n_poses} poses",
            f"record the pattern on every DoF in {_FEWEST_POSES} poses or more",
            lacks="poses",
            names=[tree.su_names[su]],
        )
    return data


def _free(n_dofs: int, new_link: bool) -> tuple[int, ...]:
    """Free parameters of a step (Fig. 4): 4 + 6, reduced for the first two DoFs (II-C.5).

    Yaw and offset along the first DoF are arbitrary, for its own SU and for the next DoF.
    """
    if n_dofs == 1:
        return _FIRST_SU
    if not new_link:
        return _SU
    return (*(_SECOND_LINK if n_dofs == 2 else _LINK), *_SU)
