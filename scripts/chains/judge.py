"""One chain: features, structure, estimate, and whether that is the global optimum and true."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from batch.records import Record

from chains.draw import Chain, draw
from chains.features import coefficients, measured
from skin2urdf.arrays import F64
from skin2urdf.errors import Skin2UrdfError
from skin2urdf.estimation.problem.blocks import feature_blocks
from skin2urdf.estimation.problem.cost import Cost
from skin2urdf.estimation.problem.state import N_JOINT, N_PLACEMENT, N_SU, State
from skin2urdf.estimation.solve.estimate import Estimate, estimate
from skin2urdf.estimation.solve.gauss_newton import gauss_newton
from skin2urdf.estimation.start.order import ordered
from skin2urdf.estimation.uncertainty.covariance import UNKNOWN
from skin2urdf.estimation.uncertainty.observability import observability
from skin2urdf.geometry.se3 import inverse, placement
from skin2urdf.geometry.so3 import frame_with_z
from skin2urdf.signals.information import Information
from skin2urdf.signals.records import Features, StaticMoves
from skin2urdf.structure.activity import activity
from skin2urdf.structure.records import KinematicTree
from skin2urdf.structure.tree import kinematic_tree

SUSPICIOUS = 2.0
"""Cost per degree of freedom from which a user is told that the fit is not good."""
_SLACK = (1.01, 5.0)
"""Factor and addend by which chi-squared may exceed that of the refinement from the truth."""
_FAR = 3.0
"""Root mean square of normalised errors up to which an estimate agrees with the truth."""


@dataclass(frozen=True)
class Case:
    """One chain to be judged.

    Attributes:
        seed: what it is drawn from.
    """

    seed: int

    @property
    def key(self) -> str:
        """Names it."""
        return f"chain {self.seed}"


@dataclass(frozen=True)
class Outcome:
    """What became of one chain.

    Attributes:
        seed: of the chain.
        dofs: number of DoFs.
        sus: number of SUs.
        poses: number of poses.
        kind: posture, layout and what was measured.
        seconds: time of the estimate from features and tree [s].
        error: what the package raised, empty where nothing.
        tree: whether the structure was found from the features; None where not looked for.
        cost_per_dof: chi-squared per degree of freedom.
        chi2: chi-squared of the estimate.
        chi2_best: chi-squared of the refinement started at the truth.
        agreement: rms of the errors of predictions in fresh configurations over their
            standard deviations.
        open: directions of placements that the features leave open at the truth, those of the base
            frame among them.
        told: directions that the package reports as open at the estimate, counted alike.
    """

    seed: int
    dofs: int
    sus: int
    poses: int
    kind: tuple[str, str, str]
    seconds: float = float("nan")
    error: str = ""
    tree: bool | None = None
    cost_per_dof: float = float("nan")
    chi2: float = float("nan")
    chi2_best: float = float("nan")
    agreement: float = float("nan")
    open: int = 0
    told: int = 0

    @property
    def at_optimum(self) -> bool:
        """Whether no better optimum is known."""
        return not self.error and self.chi2 <= _SLACK[0] * self.chi2_best + _SLACK[1]

    @property
    def agrees(self) -> bool:
        """Whether the estimate predicts fresh configurations as well as the bound promises."""
        return not self.error and self.agreement < _FAR

    @property
    def failed(self) -> bool:
        """Whether the estimate is not what the features determine."""
        return not (self.at_optimum and self.agrees)

    @property
    def recognised(self) -> bool:
        """Whether a user would notice: an error in words, or a cost that is not good."""
        return bool(self.error) or self.cost_per_dof > SUSPICIOUS


Judged = Record[Case, Outcome]
"""One line of the output."""


def outcome_of(record: Judged) -> Outcome:
    """What became of a chain, also where its process died or the package raised what is no error.

    Such a chain is drawn again to see of what kind it is.
    """
    if not record.failure:
        return record.figures
    return replace(_blank(draw(record.case.seed), record.case), error=str(record.failure))


def _blank(chain: Chain, case: Case) -> Outcome:
    """The outcome before there is an estimate."""
    kind = (chain.posture, chain.layout, chain.measured)
    return Outcome(case.seed, chain.n_dofs, len(chain.su_joint), len(chain.q), kind)


def judged(case: Case) -> Outcome:
    """Draw a chain, estimate it, and hold the estimate against the truth."""
    chain = draw(case.seed)
    features = measured(chain)
    blank = _blank(chain, case)
    tree: bool | None = None
    known = chain.tree
    if chain.measured != "no slopes":
        try:
            seen = ordered(kinematic_tree(activity(features), features), features)
            tree = same_structure(chain, seen)
        except Skin2UrdfError:
            tree = False
        known = seen if tree else known
    begin = time.perf_counter()
    try:
        found = estimate(features, known)
    except Skin2UrdfError as error:
        return replace(blank, seconds=time.perf_counter() - begin, error=str(error), tree=tree)
    seconds = time.perf_counter() - begin
    best, chi2_best = gauss_newton(found.cost, true_state(chain, known), found.free, iterations=30)
    covariance = _covariance(found, best)
    return replace(
        blank, seconds=seconds, tree=tree, cost_per_dof=found.cost_per_dof,
        chi2=found.chi2, chi2_best=chi2_best, agreement=_agreement(chain, found, covariance),
        open=_open_directions(found, covariance), told=_reported(found),
    )  # fmt: skip


def same_structure(chain: Chain, tree: KinematicTree) -> bool:
    """Whether a tree is the true one, up to the order of neighbours that commute.

    Two sliding joints in a row commute, and a sliding joint with a turning one along it: no
    measurement shows their order.
    """
    true = chain.tree
    if dict(zip(tree.joint_names, tree.joint_types, strict=True)) != dict(
        zip(true.joint_names, true.joint_types, strict=True)
    ):
        return False
    carriers = dict(zip(tree.su_names, tree.su_joint, strict=True))
    if set(carriers) != set(true.su_names):
        return False
    for u, name in enumerate(true.su_names):
        names = [tree.joint_names[j] for j in tree.chain(int(carriers[name]))]
        if not _commute_to(
            chain, [int(n.removeprefix("joint")) for n in names], int(true.su_joint[u])
        ):
            return False
    return True


def _commute_to(chain: Chain, order: list[int], last: int) -> bool:
    """Whether joints in an order move what they carry as joints 0 .. last do."""
    if sorted(order) != list(range(last + 1)):
        return False
    left = list(order)
    for wanted in range(last + 1):
        at = left.index(wanted)
        if not all(_commute(chain, wanted, other) for other in left[:at]):
            return False
        left.pop(at)
    return True


def _commute(chain: Chain, a: int, b: int) -> bool:
    slides = (chain.types[a] == "prismatic") + (chain.types[b] == "prismatic")
    parallel = abs(float(chain.axes[a] @ chain.axes[b])) > 1 - 1e-9
    return slides == 2 or (slides == 1 and parallel)


def true_state(chain: Chain, tree: KinematicTree) -> State:
    """The truth in the package's terms, for a tree with the true structure."""
    index = [int(name.removeprefix("joint")) for name in tree.joint_names]
    su = [int(name.removeprefix("su")) for name in tree.su_names]
    base = np.eye(4)
    joints = placement(frame_with_z(chain.axes[index]), chain.points[index])
    sus = placement(chain.R_base_su[su], chain.p_base_su[su])

    def local(T: F64, j: int) -> F64:
        return np.asarray(inverse(joints[j] if j >= 0 else base) @ T)

    return State(
        np.array([local(T, int(j)) for T, j in zip(joints, tree.parent, strict=True)]),
        np.array([local(T, int(j)) for T, j in zip(sus, tree.su_joint, strict=True)]),
        np.array([[0.0, 0.0, 1.0]]),
        chain.bias[su],
        np.zeros((len(su), 6)),
    )


def _agreement(chain: Chain, found: Estimate, covariance: F64) -> float:
    """Rms of the normalised errors of what SUs would read in fresh configurations.

    What an SU reads depends on no choice of frames. Standard deviations follow from the
    covariance of the coordinates; directions that nothing determines may be anywhere.
    """
    exact = coefficients(chain, chain.fresh)
    exact[:, :, 0] += chain.bias
    F, U, n = exact.shape[:3]
    unit = Features(
        tuple(f"su{u}" for u in range(U)), tuple(f"joint{d}" for d in range(chain.n_dofs)),
        chain.fresh, np.zeros(F, dtype=np.int64), exact,
        Information.of(np.tile(np.eye(n), (F, U, 1, 1))),
        np.ones((F, U, 3)), np.zeros(U), np.zeros(U),
        StaticMoves(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, U, 3))),
    )  # fmt: skip
    cost = Cost(found.tree, feature_blocks(unit, found.tree), found.cost.priors)
    here = cost.at(found.state)
    by_joint, by_su = here.jacobian()
    columns, J = here.normal_equations().columns, N_JOINT * found.tree.n_joints
    total, count = 0.0, 0
    for u in range(U):
        index = np.r_[columns[u], J + N_SU * u + np.arange(N_SU)]
        rows = np.concatenate([by_joint[u], by_su[u, : by_joint.shape[1]]], axis=1)
        variance = ((rows @ covariance[np.ix_(index, index)]) * rows).sum(axis=1)
        moves = variance > 1e-16
        total += float(np.sum(here.residual[:, u].reshape(-1)[moves] ** 2 / variance[moves]))
        count += int(moves.sum())
    return float(np.sqrt(total / max(1, count)))


def _covariance(found: Estimate, state: State) -> F64:
    """(n, n) covariance of all coordinates, joints first; 1 m, 1 rad where nothing is known."""
    system, free = found.cost.at(state).normal_equations(), found.free
    J, U = len(system.joint), len(system.su)
    H = np.zeros((J + N_SU * U, J + N_SU * U))
    H[:J, :J] = system.joint
    for u in range(U):
        own = J + N_SU * u + np.arange(N_SU)
        H[np.ix_(own, own)] = system.su[u]
        np.add.at(H, (own[:, None], system.columns[u]), system.mixed[u])
    H[:J, J:] = H[J:, :J].T
    index = np.flatnonzero(
        np.concatenate([free.joints.ravel(), free.logs.ravel(), free.sus.ravel()])
    )
    out = np.zeros_like(H)
    out[np.ix_(index, index)] = np.linalg.inv(H[np.ix_(index, index)] + np.eye(len(index)))
    return out


def _open_directions(found: Estimate, covariance: F64) -> int:
    """Directions of all placements together that the features leave open by twice UNKNOWN."""
    J = N_JOINT * found.tree.n_joints
    sus = J + N_SU * np.arange(found.tree.n_sus)[:, None] + np.arange(N_PLACEMENT)
    index = np.r_[np.arange(J), sus.ravel()]
    return int((np.linalg.eigvalsh(covariance[np.ix_(index, index)]) > (2 * UNKNOWN) ** 2).sum())


def _reported(found: Estimate) -> int:
    """Directions that the package reports as not observable, those of the base among them."""
    seen = observability(found)
    fixed = int((~found.free.sus[:, :N_PLACEMENT]).sum())
    gauge = 2 * int((found.tree.parent < 0).sum())
    return seen.n_open + gauge + sum(len(rows) for rows in seen.su_unobservable) - fixed
