"""What all exports are made from: a URDF, and the JSON beside it where there is one."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.errors import UnreadableInputError, UsageError
from skin2urdf.geometry.se3 import inverse, placement
from skin2urdf.geometry.so3 import axis_rotation
from skin2urdf.urdf.beside import document_beside
from skin2urdf.urdf.loading import check_tree, read_root

MOVABLE = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True, eq=False)
class UrdfJoint(Record):
    """A joint as a URDF has it.

    Attributes:
        name: its name.
        kind: its type.
        parent: the link it stands on.
        child: the link it carries.
        xyz: (3,) where it is placed [m].
        rpy: (3,) how it is turned there [rad].
        element: all of it.
    """

    name: str
    kind: str
    parent: str
    child: str
    xyz: F64
    rpy: F64
    element: ET.Element

    @property
    def T_parent_child(self) -> F64:
        """(4, 4) frame of the child at position 0 in the frame of the parent."""
        return placement(rotation_of_rpy(self.rpy), self.xyz)

    @property
    def axis(self) -> F64:
        """(3,) unit vector in the frame of the child."""
        element = self.element.find("axis")
        given = "1 0 0" if element is None else element.get("xyz", "1 0 0")
        axis = numbers(given, 3)
        return axis / max(float(np.linalg.norm(axis)), 1e-12)


@dataclass(frozen=True, eq=False)
class ExportedSu:
    """An SU that an export puts somewhere.

    Attributes:
        name: its link in the URDF.
        known_as: its name in the log.
        joint: the fixed joint that holds it.
        facts: what the JSON says of it; None without.
        position_open: whether the log tells nothing of its position.
        open_words: what the log does not tell of it, in words.
    """

    name: str
    known_as: str
    joint: UrdfJoint
    facts: Mapping[str, Any] | None
    position_open: bool
    open_words: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Source:
    """A URDF to export.

    Attributes:
        path: the file.
        robot: its name.
        links: its links by name.
        joints: its joints, base to tip.
        sus: its SUs.
        document: the JSON beside it; None where there is none of this very file.
        digest: SHA-256 of the file, by which an export can be traced.
    """

    path: Path
    robot: str
    links: Mapping[str, ET.Element]
    joints: tuple[UrdfJoint, ...]
    sus: tuple[ExportedSu, ...]
    document: Mapping[str, Any] | None
    digest: str

    @property
    def root(self) -> str:
        """Name of the link that no joint carries."""
        carried = {joint.child for joint in self.joints}
        return next(name for name in self.links if name not in carried)

    @property
    def movable(self) -> tuple[UrdfJoint, ...]:
        """The joints that move, base to tip."""
        return tuple(joint for joint in self.joints if joint.kind in MOVABLE)

    def placed_sus(self) -> tuple[ExportedSu, ...]:
        """The SUs of which the log tells a position.

        Raises:
            UsageError: there are none.
        """
        placed = tuple(su for su in self.sus if not su.position_open)
        if not placed:
            raise UsageError(
                f"{self.path} has no SU of which the log tells where it sits",
                "give a URDF that skin2urdf calibrated",
            )
        return placed

    @property
    def made_from(self) -> tuple[str, ...]:
        """Lines that say where an export comes from."""
        first = f"made by skin2urdf from {self.path.name} (SHA-256 {self.digest[:16]})"
        if self.document is None:
            return first, "no JSON of this file was beside it: what the log left open is not marked"
        words = str(self.document.get("verdict", {}).get("words", ""))
        return (first, words) if words else (first,)

    @property
    def header(self) -> tuple[str, ...]:
        """The same, and which SUs are left out."""
        left_out = [
            f"left out: {su.name}, since the log does not tell where it sits"
            for su in self.sus
            if su.position_open
        ]
        return (*self.made_from, *left_out)

    def path_to(self, link: str) -> tuple[UrdfJoint, ...]:
        """Joints from the root to a link."""
        by_child = {joint.child: joint for joint in self.joints}
        chain: list[UrdfJoint] = []
        while link in by_child:
            chain.append(by_child[link])
            link = by_child[link].parent
        return tuple(reversed(chain))


def load_source(path: str | Path) -> Source:
    """Read a URDF, and the JSON that was written together with it.

    SUs are the links that the JSON names. Without a JSON every link counts that ends in a fixed
    joint and has neither mesh nor child, as SUs do.

    Args:
        path: the URDF.

    Raises:
        UnreadableInputError: it is no URDF of one tree, or a number in it is none.
    """
    import hashlib

    path = Path(path)
    root = read_root(path)
    _, leaves = check_tree(root, str(path))
    links = {link.get("name", ""): link for link in root.findall("link")}
    try:
        joints = _base_to_tip([_joint(element) for element in root.findall("joint")])
    except ValueError as error:
        raise UnreadableInputError(str(path), str(error), "check it with check_urdf") from error
    beside = document_beside(path)
    document = None if beside is None else json.loads(beside.read_bytes())
    by_child = {joint.child: joint for joint in joints}
    if document is None:
        bare = [name for name in leaves if not _has_mesh(links[name])]
        sus = [ExportedSu(name, name, by_child[name], None, False, ()) for name in bare]
    else:
        sus = [
            _su(name, link, by_child[link], document)
            for name in document.get("sus", {})
            for link in (name, f"{name}_su")
            if link in leaves
        ]
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    name = root.get("name") or path.stem
    return Source(path, name, links, tuple(joints), tuple(sus), document, digest)


def rotation_of_rpy(rpy: F64) -> F64:
    """(3, 3) rotation of roll, pitch and yaw (3,), as URDF means them."""
    x, y, z = (axis_rotation(np.eye(3)[i], np.asarray(rpy[i])) for i in range(3))
    return np.asarray(z @ y @ x)


def quaternion(R: F64) -> F64:
    """(4,) unit quaternion w, x, y, z of a rotation, the largest part positive."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(R).as_quat()
    q = np.array([w, x, y, z])
    return np.asarray(q * np.sign(q[np.argmax(np.abs(q))]))


def numbers(text: str, count: int) -> F64:
    """Numbers parted by spaces; ValueError where these are not ``count`` finite ones."""
    values = np.array([float(part) for part in text.split()])
    if values.shape != (count,) or not np.isfinite(values).all():
        raise ValueError(f"{text!r} is not {count} numbers")
    return values


def origin(element: ET.Element) -> tuple[F64, F64]:
    """(3,) xyz [m] and (3,) rpy [rad] of an element's origin; zero where it has none."""
    found = element.find("origin")
    if found is None:
        return np.zeros(3), np.zeros(3)
    return numbers(found.get("xyz", "0 0 0"), 3), numbers(found.get("rpy", "0 0 0"), 3)


def decimal(value: float) -> str:
    """Shortest decimal that reads back as the same float64; -0 as 0."""
    return repr(float(value) + 0.0)


def decimals(values: Sequence[float] | F64) -> str:
    """Numbers parted by spaces, see :func:`decimal`."""
    return " ".join(decimal(value) for value in values)


def T_link_su(su: ExportedSu) -> F64:
    """(4, 4) frame of an SU in that of the link it sits on."""
    return su.joint.T_parent_child


def T_su_link(su: ExportedSu) -> F64:
    """(4, 4) frame of the link in that of the SU."""
    return inverse(su.joint.T_parent_child)


def _joint(element: ET.Element) -> UrdfJoint:
    parent, child = (element.find(tag) for tag in ("parent", "child"))
    if parent is None or child is None:
        raise ValueError(f"joint {element.get('name')!r} has no parent or no child")
    xyz, rpy = origin(element)
    return UrdfJoint(
        element.get("name", ""),
        element.get("type", ""),
        parent.get("link", ""),
        child.get("link", ""),
        xyz,
        rpy,
        element,
    )


def _base_to_tip(joints: Sequence[UrdfJoint]) -> list[UrdfJoint]:
    """Joints in an order in which each comes after those before it, else as in the file."""
    carried = {joint.child for joint in joints}
    reached = {joint.parent for joint in joints} - carried
    left, ordered = list(joints), []
    while left:
        ready = [joint for joint in left if joint.parent in reached]
        ordered += ready
        reached |= {joint.child for joint in ready}
        left = [joint for joint in left if joint.child not in reached]
        if not ready:
            break
    return ordered


def _su(name: str, link: str, joint: UrdfJoint, document: Mapping[str, Any]) -> ExportedSu:
    """An SU with what the JSON says of it."""
    entry = document.get("observability", {}).get("sus", {}).get(name, {})
    rows = entry.get("unobservable")
    free = np.eye(6) if rows is None else np.reshape(rows, (-1, 6)).astype(float)
    nowhere = len(free) >= 3 and np.linalg.matrix_rank(free[:, :3], tol=0.5) == 3
    words = tuple(str(each.get("what", "")) for each in entry.get("words", ()))
    return ExportedSu(link, name, joint, document["sus"][name], bool(nowhere), words)


def _has_mesh(link: ET.Element) -> bool:
    return link.find(".//mesh") is not None
