"""An earlier calibration: the robot as it was found, and how well each part of it is known."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.errors import UnreadableInputError
from skin2urdf.estimation.problem.state import JOINT_COORDINATES
from skin2urdf.estimation.uncertainty.observability import ARM
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.model.records import KinematicModel
from skin2urdf.planning.expected import Expected
from skin2urdf.planning.limits import Given
from skin2urdf.structure.records import JointType, KinematicTree

_OPEN = 0.1
"""Standard deviation along a direction that the earlier logs left open [m, or rad times ARM]."""
_LEAST = 1e-7
"""Smallest standard deviation that is taken at its word [m or rad]."""


@dataclass(frozen=True, eq=False)
class Earlier(Record):
    """An earlier calibration.

    Attributes:
        path: its JSON.
        model: the robot as it was found; its base is upright.
        joint_covariance: (D, 4, 4) of each joint's coordinates tx, ty [m], rx, ry [rad].
        su_covariance: (U, 6, 6) of each SU's placement [m, rad], directions that were left open
            included, and what no recording tells taken off.
        limits: ranges and speeds that were seen.
        open: names of joints and SUs that have directions which the earlier logs left open.
    """

    path: str
    model: KinematicModel
    joint_covariance: F64
    su_covariance: F64
    limits: dict[str, Given]
    open: frozenset[str]

    @property
    def information(self) -> tuple[F64, F64]:
        """(D, 4, 4) and (U, 6, 6) information on placements of joints and SUs."""
        return _inverse(self.joint_covariance), _inverse(self.su_covariance)


@dataclass(frozen=True)
class Shrinking:
    """How an uncertainty shrinks.

    Attributes:
        what: a joint or an SU.
        before: standard deviation of its position (an SU's) or of its axis [m].
        after: what is to be expected with the recording that is planned.
    """

    what: str
    before: float
    after: float


def seen_ranges(path: str | Path) -> dict[str, Given]:
    """Ranges and speeds of joints that the log of a calibration saw, by joint.

    Args:
        path: the JSON beside a URDF.

    Returns:
        Nothing for a calibration on a vendor's model, whose file has the vendor's limits.

    Raises:
        UnreadableInputError: it can not be read, or is something else.
    """
    data = json.loads(Path(path).read_text(encoding="utf-8"))
    return {} if data.get("model") else read_earlier(path).limits


def read_earlier(path: str | Path) -> Earlier:
    """Read the JSON that a calibration wrote.

    Raises:
        UnreadableInputError: it can not be read, or is something else.
    """
    try:
        data = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise UnreadableInputError(
            str(path), f"can not be read: {error.strerror or error}", "check the path"
        ) from error
    except ValueError as error:
        raise UnreadableInputError(
            str(path), f"is not JSON: {error}", "give the JSON that calibrate wrote"
        ) from error
    try:
        return _earlier(str(path), data)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UnreadableInputError(
            str(path),
            f"is not the JSON of a calibration: {error!r}",
            "give the JSON that skin2urdf calibrate wrote beside the URDF",
        ) from error


def shrinking(earlier: Earlier, found: Expected, most: int = 3) -> tuple[Shrinking, ...]:
    """The largest uncertainties of positions, and what will be left of them.

    Args:
        earlier: what is known.
        found: what the new recording alone will tell of the same robot.
        most: how many.
    """
    tree, seen = earlier.model.tree, found.observability
    new_su = seen.su_covariance + _along(seen.su_unobservable)
    new_su[:, range(3, 6), range(3, 6)] -= seen.hidden_rotation**2  # as in what is known
    known = _inverse(seen.joint_covariance), _inverse(new_su)
    # What nothing tells of a joint has no variance, which is not to be mistaken for knowledge.
    known[0][[verdict == "not observable" for verdict in seen.joint_verdict]] = 0.0
    out: list[Shrinking] = []
    for names, old, new, lengths in (
        (tree.joint_names, earlier.joint_covariance, known[0], 2),
        (tree.su_names, earlier.su_covariance, known[1], 3),
    ):
        both = _inverse(_inverse(old) + new)
        for name, before, after in zip(names, old, both, strict=True):
            if name not in earlier.open:
                sizes = [float(np.sqrt(np.trace(x[:lengths, :lengths]))) for x in (before, after)]
                out.append(Shrinking(name, sizes[0], sizes[1]))
    return tuple(sorted(out, key=lambda each: -each.before)[:most])


def _earlier(path: str, data: dict[str, Any]) -> Earlier:
    joints = [str(joint["name"]) for joint in data["tree"]["joints"]]
    parents = [joint["parent"] for joint in data["tree"]["joints"]]
    types: list[JointType] = [
        "prismatic" if joint["type"] == "prismatic" else "revolute"
        for joint in data["tree"]["joints"]
    ]
    sus = list(data["sus"])
    of = [data["sus"][name] for name in sus]
    tree = KinematicTree(
        tuple(joints),
        np.array([_index(joints, name) for name in parents], dtype=np.int64),
        tuple(types),
        tuple(sus),
        np.array([_index(joints, su["joint"]) for su in of], dtype=np.int64),
    )
    T_joint = np.array([data["joints"][name]["T_parent_joint"] for name in joints], dtype=float)
    T_su = np.array([su["T_joint_su"] for su in of], dtype=float)
    model = KinematicModel(tree, T_joint.reshape(-1, 4, 4), T_su.reshape(-1, 4, 4))
    six = np.array([data["joints"][name]["covariance"] for name in joints], dtype=float)
    index = np.array(JOINT_COORDINATES)
    joint = six[:, index[:, None], index] - _of_gravity(data, model.T_parent_joint)[:, :4, :4]
    su = np.array([s["covariance"] for s in of], dtype=float)
    su[:, range(3, 6), range(3, 6)] -= float(data["observability"]["hidden_rotation_rad"]) ** 2
    of_gravity = _of_gravity(data, model.T_joint_su)
    su[:, :3, :3] -= of_gravity[:, [[0], [1], [4]], [0, 1, 4]]
    rows = [np.reshape(data["observability"]["sus"][name]["unobservable"], (-1, 6)) for name in sus]
    verdicts = {name: data["joints"][name]["verdict"] for name in joints}
    verdicts |= {name: each["verdict"] for name, each in zip(sus, of, strict=True)}
    open_ = frozenset(name for name, verdict in verdicts.items() if verdict == "not observable")
    wide = np.array([name in open_ for name in joints])[:, None, None]
    joint = _sound(joint) + wide * np.diag([_OPEN, _OPEN, 0.0, 0.0]) ** 2
    return Earlier(path, model, joint, _sound(su) + _along(rows), _limits(data, joints), open_)


def _of_gravity(data: dict[str, Any], T: F64) -> F64:
    """(n, 5, 5) covariance of offsets x, y (two angles) and z, which gravity's size leaves open.

    All lengths grow with it alike.
    """
    relative = float(data["settings"].get("gravity_deviation", 0.0)) / GRAVITY
    local = np.einsum("nji,nj->ni", T[:, :3, :3], T[:, :3, 3]) * relative
    full = np.zeros((len(T), 5))
    full[:, [0, 1, 4]] = local
    return np.asarray(full[:, :, None] * full[:, None, :])


def _limits(data: dict[str, Any], joints: Sequence[str]) -> dict[str, Given]:
    """Ranges and speeds that were seen."""
    out = {}
    for name in joints:
        joint = data["joints"][name]
        low, high = joint["limits"]
        endless = joint["type"] == "continuous"
        out[name] = Given(
            prismatic=joint["type"] == "prismatic",
            lower=None if endless else float(low),
            upper=None if endless else float(high),
            velocity=float(joint["velocity"]),
        )
    return out


def _along(directions: Sequence[F64]) -> F64:
    """(U, 6, 6) covariance along open directions (k, 6) (linear, angular times ARM)."""
    out = np.zeros((len(directions), 6, 6))
    for C, rows in zip(out, directions, strict=True):
        twists = np.reshape(rows, (-1, 6)) / np.r_[1.0, 1.0, 1.0, ARM, ARM, ARM]
        C += _OPEN**2 * twists.T @ twists
    return out


def _sound(covariance: F64) -> F64:
    """The nearest covariance (n, k, k) without variances that are below what can be believed."""
    lam, V = np.linalg.eigh(0.5 * (covariance + np.swapaxes(covariance, 1, 2)))
    return np.asarray((V * np.maximum(lam, _LEAST**2)[:, None, :]) @ np.swapaxes(V, 1, 2))


def _inverse(matrices: F64) -> F64:
    """Inverses (n, k, k) of covariances or information."""
    lam, V = np.linalg.eigh(0.5 * (matrices + np.swapaxes(matrices, 1, 2)))
    least = np.maximum(lam, 1e-14 * np.maximum(lam.max(axis=1, keepdims=True), 1e-30))
    return np.asarray((V / least[:, None, :]) @ np.swapaxes(V, 1, 2))


def _index(names: Sequence[str], name: str | None) -> int:
    return -1 if name is None else names.index(name)
