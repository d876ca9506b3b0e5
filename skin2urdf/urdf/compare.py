"""How far an estimated robot is from the true one, free choices of frames aside.

Nothing that a log can not tell, or that two good URDFs may choose differently, counts: the base
frames are aligned by one rigid transform, joint frames may be turned about and slid along their
axes, links may have any names. What counts is where the SUs are at the same joint positions, and
where the axes are.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.errors import InsufficientDataError, UnreadableInputError, UsageError
from skin2urdf.urdf import twists
from skin2urdf.urdf.alignment import align, projector
from skin2urdf.urdf.loading import Robot, configuration, load_robot
from skin2urdf.urdf.records import Comparison, JointError, Spread, SuError

_RANK = 1e-6  # singular values below this count as 0 in given directions


def compare(
    estimate: str | Path,
    truth: str | Path,
    *,
    unobservable: Mapping[str, F64] | None = None,
    n_configurations: int = 200,
    rng: np.random.Generator,
) -> Comparison:
    """Compare an estimated URDF with the true one.

    SUs are the links of the estimate that end in a fixed joint and that the truth has, too. Both
    robots take the same random positions of the joints they share, inside the limits of both.
    Joints that only one of them has stay at the position nearest to 0.

    An SU with unobservable directions is moved along them, once for all configurations, to where
    it fits best, and what remains is its error. Finite displacements are followed exactly (an SU
    that may sit anywhere on a circle about a vertical first axis). SUs of which nothing is
    observable are left out altogether.

    The distance of two axis lines is taken where it matters: from the point of the true axis that
    is nearest to the middle of the SUs which the joint carries, square to the estimated axis. The
    distance along the common normal would be meaningless, because two lines that should coincide
    and do not quite are nearest to each other anywhere.

    Args:
        estimate: the estimated URDF.
        truth: the true URDF; SU frames are links of the same names.
        unobservable: per SU name (k, 6) twists xi in the SU's own frame along which the log says
            nothing, ``T_joint_su -> T_joint_su exp(xi)``: linear part [m] first, angular part
            [rad] times 0.1 m/rad. SUs without an entry are observable.
        n_configurations: number of random configurations.
        rng: source of the configurations.

    Returns:
        The errors and the verdict on the tree.

    Raises:
        UnreadableInputError: a file is no URDF.
        UsageError: the robots share no SU, or directions are not (k, 6) finite numbers.
        InsufficientDataError: no SU is observable.
    """
    if n_configurations < 1:
        raise UsageError(f"{n_configurations} configurations can not be compared", "give 1 or more")
    est, true = load_robot(estimate), load_robot(truth)
    shared = [name for name in est.fixed_leaves if name in true.links]
    if not shared:
        raise UsageError(
            f"no link on a fixed joint of {estimate} is also a link of {truth}",
            "compare with the truth of the same log: SUs are recognised by their names",
        )
    free = {name: _directions(name, (unobservable or {}).get(name)) for name in shared}
    hidden = tuple(name for name in shared if len(free[name]) == 6)
    sus = [name for name in shared if name not in hidden]
    if not sus:
        raise InsufficientDataError(
            "nothing to compare: no SU of the estimate is observable",
            "record a log in which the joints move",
        )
    joints = [name for name in est.joint_types if name in true.joint_types]
    held = [n for r in (est, true) for n in r.joint_types if n not in joints]

    positions = random_positions(est, true, joints, n_configurations, rng)
    T_est_su, axes_est = _kinematics(est, sus, joints, positions)
    T_true_su, axes_true = _kinematics(true, sus, joints, positions)
    X, D = align(T_est_su, T_true_su, [free[name] for name in sus])
    T_est_su = X @ T_est_su @ D
    axes_est = np.einsum("ij,ndj->ndi", twists.adjoint(X), axes_est)

    shift = np.linalg.norm(T_true_su[..., :3, 3] - T_est_su[..., :3, 3], axis=-1)
    R_error = np.swapaxes(T_est_su[..., :3, :3], -1, -2) @ T_true_su[..., :3, :3]
    turn = np.linalg.norm(twists.rotation_vector(R_error), axis=-1)
    told = np.array([_told(free[name]) for name in sus])
    differences = _tree_differences(est, true, shared, joints)
    joint_errors, angle, distance = _joint_errors(
        est, true, joints, sus, T_true_su, axes_est, axes_true
    )
    return Comparison(
        sus=tuple(
            SuError(
                name,
                Spread.of(shift[:, u]) if told[u, 0] else None,
                Spread.of(turn[:, u]) if told[u, 1] else None,
                len(free[name]),
            )
            for u, name in enumerate(sus)
        ),
        joints=joint_errors,
        position=Spread.of(shift[:, told[:, 0]]),
        orientation=Spread.of(turn[:, told[:, 1]]),
        axis_angle=Spread.of(angle),
        axis_distance=Spread.of(distance),
        T_truth_estimate=X,
        tree_equal=not differences,
        tree_differences=differences,
        not_observable=hidden,
        unmatched=tuple(name for name in est.fixed_leaves if name not in true.links),
        held_joints=tuple(held),
        n_configurations=n_configurations,
    )


def load_unobservable(path: str | Path) -> dict[str, F64] | None:
    """Read the unobservable directions of SUs from the JSON beside an estimated URDF.

    Args:
        path: the JSON file; ``observability.sus[name].unobservable`` is a list of k vectors of 6
            numbers, or null where nothing is known of the SU.

    Returns:
        (k, 6) directions per SU, as :func:`compare` takes them; all six for null. None where
        there is no such file or it holds no observability.

    Raises:
        UnreadableInputError: the file is no JSON, or the entry has another shape.
    """
    path = Path(path)
    try:
        content: Any = json.loads(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise UnreadableInputError(
            str(path), f"is not a JSON file: {error}", "remove it to compare without it"
        ) from error
    entry = content.get("observability") if isinstance(content, dict) else None
    sus = entry.get("sus") if isinstance(entry, dict) else None
    if not isinstance(sus, dict):
        return None
    result: dict[str, F64] = {}
    for name, su in sus.items():
        if not isinstance(su, dict) or "unobservable" not in su:
            continue
        try:
            result[name] = _directions(name, su["unobservable"], nothing_known=np.eye(6))
        except UsageError as error:
            raise UnreadableInputError(str(path), str(error), error.remedy) from error
    return result


def _directions(name: str, given: Any, nothing_known: F64 | None = None) -> F64:
    """(k, 6) orthonormal directions that span the ``given`` ones; k is their rank."""
    if given is None:
        return np.zeros((0, 6)) if nothing_known is None else nothing_known
    try:
        rows = np.asarray(given, float)
        rows = rows.reshape(0, 6) if rows.size == 0 else rows
    except (TypeError, ValueError):
        rows = np.zeros(0)
    if rows.ndim != 2 or rows.shape[1] != 6 or not np.isfinite(rows).all():
        raise UsageError(
            f"the unobservable directions of SU {name!r} are not rows of 6 numbers",
            "give (k, 6) twists, linear part first",
        )
    _, values, Vt = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(Vt[values > _RANK])


def _told(free: F64) -> tuple[bool, bool]:
    """Whether any part of the position, and of the orientation, is not free."""
    P = projector(free)
    return float(np.trace(P[:3, :3])) < 3 - _RANK, float(np.trace(P[3:, 3:])) < 3 - _RANK


def random_positions(
    est: Robot, true: Robot, joints: Sequence[str], n: int, rng: np.random.Generator
) -> F64:
    """(n, D) positions inside the limits of both robots [rad or m].

    Where the limits do not meet those of the estimate hold, since they are where the data were;
    a side without a limit ends half a turn (or half a metre) from 0 or from the other side.
    """
    result = np.empty((n, len(joints)))
    for j, name in enumerate(joints):
        low, high = np.array([est.limits[name], true.limits[name]]).T
        lower, upper = low.max(), high.min()
        if lower > upper:
            lower, upper = est.limits[name]
        reach = np.pi if est.joint_types[name] == "revolute" else 0.5
        if not np.isfinite(lower):
            lower = min(-reach, upper - reach) if np.isfinite(upper) else -reach
        if not np.isfinite(upper):
            upper = max(reach, lower + reach)
        result[:, j] = rng.uniform(lower, upper, n)
    return result


def _kinematics(
    robot: Robot, sus: Sequence[str], joints: Sequence[str], positions: F64
) -> tuple[F64, F64]:
    """Poses and axes of one robot at n configurations.

    Returns:
        (n, U, 4, 4) SU poses in the base frame, and (n, D, 6) columns of the joints' Jacobian
        there: for a revolute joint the axis w and ``v = -w x (any point of the axis)``, for a
        prismatic one v alone; linear part first.
    """
    import pinocchio as pin

    data = robot.model.createData()
    frames = [robot.frame(name) for name in sus]
    columns = [robot.model.joints[robot.model.getJointId(name)].idx_v for name in joints]
    T_base_su = np.empty((len(positions), len(sus), 4, 4))
    axes = np.empty((len(positions), len(joints), 6))
    for n, values in enumerate(positions):
        q = configuration(robot, dict(zip(joints, map(float, values), strict=True)))
        # Pinocchio hands a matrix of one column over as a vector.
        jacobian = pin.computeJointJacobians(robot.model, data, q).reshape(6, robot.model.nv)
        axes[n] = jacobian[:, columns].T
        for u, frame in enumerate(frames):
            T_base_su[n, u] = pin.updateFramePlacement(robot.model, data, frame).homogeneous
    return T_base_su, axes


def _joint_errors(
    est: Robot,
    true: Robot,
    joints: Sequence[str],
    sus: Sequence[str],
    T_true_su: F64,
    axes_est: F64,
    axes_true: F64,
) -> tuple[tuple[JointError, ...], F64, F64]:
    """Errors per joint, and all angles [rad] and distances [m] there are, in one array each.

    Joints whose types differ have no axes to compare; the tree's differences name them.
    """
    errors: list[JointError] = []
    angles: list[F64] = [np.zeros(0)]
    distances: list[F64] = [np.zeros(0)]
    chains = [true.chain(su) for su in sus]
    positions = T_true_su[..., :3, 3]
    for d, name in enumerate(joints):
        kind = est.joint_types[name]
        if kind != true.joint_types[name]:
            continue
        part = slice(3, 6) if kind == "revolute" else slice(0, 3)
        w_est, w_true = axes_est[:, d, part], axes_true[:, d, part]
        sine = np.linalg.norm(np.cross(w_est, w_true), axis=-1)
        angle = np.arctan2(sine, np.sum(w_est * w_true, axis=-1))
        angles.append(angle)
        distance = None
        if kind == "revolute":
            carried = [u for u, chain in enumerate(chains) if name in chain]
            places = positions[:, carried or slice(None)].mean(axis=1)
            v_est, v_true = axes_est[:, d, :3], axes_true[:, d, :3]
            foot = np.cross(w_true, v_true)
            foot = foot + w_true * np.sum(w_true * (places - foot), axis=-1, keepdims=True)
            # |v + w x p| is the distance of p from the line of the unit twist (v, w).
            distance = np.linalg.norm(v_est + np.cross(w_est, foot), axis=-1)
            distances.append(distance)
        spread = None if distance is None else Spread.of(distance)
        errors.append(JointError(name, kind, Spread.of(angle), spread))
    return tuple(errors), np.concatenate(angles), np.concatenate(distances)


def _tree_differences(
    est: Robot, true: Robot, sus: Sequence[str], joints: Sequence[str]
) -> tuple[str, ...]:
    """Where the trees differ, in words: joint types, extra joints, joints before each SU."""
    differences = [
        f"joint {name} is {est.joint_types[name]}, but {true.joint_types[name]} in the truth"
        for name in joints
        if est.joint_types[name] != true.joint_types[name]
    ]
    differences += [
        f"joint {name} is not in the truth" for name in est.joint_types if name not in joints
    ]
    for su in sus:
        found, right = ([j for j in r.chain(su) if j in joints] for r in (est, true))
        if found != right:
            words = [", ".join(chain) or "no joint" for chain in (found, right)]
            differences.append(f"SU {su} hangs on {words[0]}; in the truth on {words[1]}")
    return tuple(differences)
