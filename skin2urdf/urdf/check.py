"""Read an emitted URDF back, the way its users will, before it replaces an older one."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.errors import Skin2UrdfError
from skin2urdf.geometry.se3 import exp, screw
from skin2urdf.model.records import KinematicModel
from skin2urdf.urdf.names import BASE_LINK, urdf_names

TOLERANCE = 1e-9
"""Largest difference of any entry of an SU's pose [m, 1]."""
_CONFIGURATIONS = 3


class InconsistentUrdfError(Skin2UrdfError):
    """A URDF that does not say what the model says: a defect of this package."""

    def __init__(self, what: str) -> None:
        super().__init__(
            f"the URDF does not hold the robot that was found: {what}",
            "nothing was written; please report this with the log, it is a defect of skin2urdf",
        )


def check_urdf(text: str, model: KinematicModel, rng: np.random.Generator | None = None) -> None:
    """Make sure that a URDF reads back as the model it was made of.

    Pinocchio loads it, and its elements are looked through. By both, every SU must be where the
    model has it, at random joint positions; the model's own kinematics are products of transforms.
    Of other readers, which take half a second to load, the tests see that they agree.

    Args:
        text: the URDF.
        model: what it should hold.
        rng: source of the joint positions; a fixed one by default.

    Raises:
        InconsistentUrdfError: it does not.
    """
    rng = rng or np.random.default_rng(0)
    q = rng.uniform(-1.0, 1.0, (_CONFIGURATIONS, model.tree.n_joints))
    expected = [su_poses(model, row) for row in q]
    for reader in (_by_pinocchio, _by_elements):
        name = reader.__name__.removeprefix("_by_")
        try:
            read = reader(text, model, q)
        except InconsistentUrdfError:
            raise
        except Exception as error:
            raise InconsistentUrdfError(f"{name} can not load it ({error})") from error
        error_size = float(np.max(np.abs(np.array(read) - np.array(expected)), initial=0.0))
        if not error_size <= TOLERANCE:
            raise InconsistentUrdfError(f"{name} has SUs {error_size:.1e} away from the model's")


def su_poses(model: KinematicModel, q: F64) -> F64:
    """(U, 4, 4) SU poses in the base frame at joint positions q (D,), by plain products."""
    tree = model.tree
    T_base_joint = np.tile(np.eye(4), (tree.n_joints + 1, 1, 1))  # index -1 is the base
    for j, parent in enumerate(tree.parent):
        motion = screw("z", 0.0, q[j]) if tree.prismatic[j] else screw("z", q[j], 0.0)
        T_base_joint[j] = T_base_joint[parent] @ model.T_parent_joint[j] @ motion
    return np.asarray(T_base_joint[tree.su_joint] @ model.T_joint_su)


def _by_pinocchio(text: str, model: KinematicModel, q: F64) -> list[list[F64]]:
    """SU poses (C, U, 4, 4) as Pinocchio reads them."""
    import pinocchio as pin

    loaded = pin.buildModelFromXML(text)
    data = loaded.createData()
    if sorted(loaded.names[1:]) != sorted(model.tree.joint_names):
        raise InconsistentUrdfError("Pinocchio finds other joints")
    joints = [loaded.joints[loaded.getJointId(n)] for n in model.tree.joint_names]
    frames = [loaded.getFrameId(n, pin.FrameType.BODY) for n in urdf_names(model.tree).su_links]
    poses = []
    for row in q:
        configuration = pin.neutral(loaded)
        for joint, position in zip(joints, row, strict=True):
            endless = joint.nq == 2
            value = (np.cos(position), np.sin(position)) if endless else position
            configuration[joint.idx_q : joint.idx_q + joint.nq] = value
        pin.framesForwardKinematics(loaded, data, configuration)
        poses.append([data.oMf[frame].homogeneous for frame in frames])
    return poses


def _by_elements(text: str, model: KinematicModel, q: F64) -> F64:
    """SU poses (C, U, 4, 4) as the elements say, which are looked through as well.

    Readers differ in what they put up with. Where names are unique, every link but the base hangs
    on one joint, and every joint says what its type asks for, none of them is left to guess.
    """
    root = ET.fromstring(text)  # noqa: S314  (our own text)
    links = [link.get("name", "") for link in root.findall("link")]
    joints = {joint.get("name", ""): joint for joint in root.findall("joint")}
    carried = {_linked(joint, "child"): joint for joint in joints.values()}
    if len(set(links)) < len(links) or len(joints) < len(root.findall("joint")):
        raise InconsistentUrdfError("names of links or joints are not unique")
    if len(carried) < len(joints) or {BASE_LINK, *carried} != set(links):
        raise InconsistentUrdfError("a link other than the base does not hang on one joint")
    position = dict(zip(model.tree.joint_names, q.T, strict=True))
    T = {BASE_LINK: np.tile(np.eye(4), (len(q), 1, 1))}

    def pose(link: str) -> F64:
        """(C, 4, 4) of a link in the base frame."""
        if link not in T:
            joint = carried.pop(link)  # one that carries itself is missed the next time
            T[link] = pose(_linked(joint, "parent")) @ _moved(joint, position)
        return T[link]

    out = np.empty((len(q), model.tree.n_sus, 4, 4))
    for u, link in enumerate(urdf_names(model.tree).su_links):
        out[:, u] = pose(link)
    return out


def _linked(joint: ET.Element, end: str) -> str:
    """Name of a joint's parent or child."""
    found = joint.find(end)
    return "" if found is None else found.get("link", "")


def _moved(joint: ET.Element, position: Mapping[str, F64]) -> F64:
    """(..., 4, 4) what a joint does at positions (C,), by the names of those that move."""
    origin = joint.find("origin")
    x, y, z = _numbers(origin, "xyz", (0.0, 0.0, 0.0))
    roll, pitch, yaw = _numbers(origin, "rpy", (0.0, 0.0, 0.0))
    T = screw("z", yaw, 0.0) @ screw("y", pitch, 0.0) @ screw("x", roll, 0.0)
    T[:3, 3] = x, y, z
    name, kind = joint.get("name", ""), joint.get("type")
    if kind == "fixed":
        return T
    if kind not in ("revolute", "continuous", "prismatic") or name not in position:
        raise InconsistentUrdfError(f"the joint {name} is {kind}")
    limit = joint.find("limit")
    ends = ("lower", "upper") if kind != "continuous" else ()
    said = {key: _numbers(limit, key, ())[0] for key in (*ends, "effort", "velocity")}
    if not all(map(np.isfinite, said.values())) or (ends and said["lower"] > said["upper"]):
        raise InconsistentUrdfError(f"the limits of the joint {name} are none: {said}")
    axis = np.array(_numbers(joint.find("axis"), "xyz", (1.0, 0.0, 0.0)))
    motion = np.multiply.outer(position[name], axis)
    none = np.zeros_like(motion)
    twist = [motion, none] if kind == "prismatic" else [none, motion]
    return np.asarray(T @ exp(np.concatenate(twist, axis=1)))


def _numbers(element: ET.Element | None, key: str, default: Sequence[float]) -> Sequence[float]:
    """Numbers of an attribute; those that stand for it where it is missing, if it may be."""
    text = None if element is None else element.get(key)
    if text is None and not default:
        raise InconsistentUrdfError(f"a joint has no {key}")
    return default if text is None else [float(word) for word in text.split()]
