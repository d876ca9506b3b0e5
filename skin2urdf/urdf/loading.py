"""URDFs as Pinocchio sees them, with errors that a person understands."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.errors import Unreadable, UnreadableInputError
from skin2urdf.files import read_description
from skin2urdf.structure.records import JointType

# A robot with a thousand SUs has some more than a thousand links. What is made of each pair of
# links takes seconds and a gigabyte at ten thousand.
MOST_LINKS = 5000


@dataclass(frozen=True, eq=False)
class Robot:
    """A URDF loaded for kinematics.

    Attributes:
        path: where it came from.
        model: its ``pinocchio.Model``, fixed base.
        joint_types: names and types of the single-DoF joints, base to tip.
        limits: lower and upper position limit of each of them [rad or m]; +-inf where unlimited.
        links: names of all links.
        fixed_leaves: names of links on a fixed joint that carry nothing, as SUs do.
    """

    path: Path
    model: Any
    joint_types: dict[str, JointType]
    limits: dict[str, tuple[float, float]]
    links: frozenset[str]
    fixed_leaves: tuple[str, ...]

    def chain(self, link: str) -> tuple[str, ...]:
        """Names of the movable joints from the base to ``link``."""
        return self._ancestors(self.model.frames[self.frame(link)].parentJoint)

    def chain_of_joint(self, name: str) -> tuple[str, ...]:
        """Names of the movable joints from the base to the joint ``name``, both included."""
        return self._ancestors(self.model.getJointId(name))

    def _ancestors(self, joint: int) -> tuple[str, ...]:
        """Names of the joints from the base to Pinocchio's joint of that index."""
        names: list[str] = []
        while joint > 0:
            names.append(self.model.names[joint])
            joint = self.model.parents[joint]
        return tuple(reversed(names))

    def frame(self, link: str) -> int:
        """Index of the frame of ``link`` in the Pinocchio model."""
        import pinocchio as pin

        return int(self.model.getFrameId(link, pin.FrameType.BODY))

    def displaced(self, joints: Mapping[str, F64], links: Mapping[str, F64]) -> Robot:
        """The robot with some placements moved, ``T -> T exp(xi)``.

        Args:
            joints: (6,) twists (linear [m], angular [rad]) of joint placements, by joint name.
            links: the same of links on fixed joints, by link name.
        """
        import pinocchio as pin

        model = self.model.copy()
        for name, xi in joints.items():
            joint = model.getJointId(name)
            model.jointPlacements[joint] *= pin.exp6(pin.Motion(np.array(xi)))
        for name, xi in links.items():
            frame = model.frames[self.frame(name)]
            frame.placement = frame.placement * pin.exp6(pin.Motion(np.array(xi)))
        return replace(self, model=model)

    def within(self, ranges: Mapping[str, tuple[float, float]]) -> Robot:
        """The robot with other limits of some joints, by name [rad or m]."""
        known = {name: ends for name, ends in ranges.items() if name in self.limits}
        return replace(self, limits=self.limits | known)

    def renamed(self, names: Mapping[str, str]) -> Robot:
        """The robot with other names of joints, by their names so far; the rest keep theirs."""
        model = self.model.copy()
        for old, new in names.items():
            model.names[model.getJointId(old)] = new
        return replace(
            self,
            model=model,
            joint_types={names.get(n, n): kind for n, kind in self.joint_types.items()},
            limits={names.get(n, n): limits for n, limits in self.limits.items()},
        )


def load_robot(path: str | Path) -> Robot:
    """Load a URDF for kinematics; meshes are not needed.

    Args:
        path: URDF file.

    Raises:
        UnreadableInputError: there is no such file, or it is no XML, or no URDF of one tree.
    """
    path = Path(path)
    root = read_root(path)
    links, leaves = check_tree(root, str(path))

    import pinocchio as pin

    try:
        model = pin.buildModelFromUrdf(str(path))
    except (ValueError, RuntimeError) as error:
        raise UnreadableInputError(
            str(path),
            f"Pinocchio can not load it: {error}",
            "check it with check_urdf",
            "refused",
        ) from error
    types: dict[str, JointType] = {}
    limits: dict[str, tuple[float, float]] = {}
    for joint in list(model.joints)[1:]:
        kind = _joint_type(joint.shortname())
        if kind is not None:
            name = model.names[joint.id]
            types[name] = kind
            limits[name] = (-np.inf, np.inf)
            if joint.nq == 1:
                lower, upper = model.lowerPositionLimit, model.upperPositionLimit
                limits[name] = (float(lower[joint.idx_q]), float(upper[joint.idx_q]))
    return Robot(path, model, types, limits, links, leaves)


def neutral(robot: Robot) -> dict[str, float]:
    """Position of every single-DoF joint nearest to 0 inside its limits [rad or m]."""
    return {name: float(np.clip(0.0, *limits)) for name, limits in robot.limits.items()}


def configuration(robot: Robot, positions: dict[str, float]) -> F64:
    """(nq,) configuration vector; joints not named are neutral, continuous ones (cos, sin)."""
    (q,) = configurations(robot, list(positions), np.array([list(positions.values())]))
    return np.asarray(q)


def configurations(robot: Robot, joints: Sequence[str], positions: F64) -> F64:
    """(n, nq) configuration vectors.

    Args:
        robot: the robot.
        joints: names of D joints.
        positions: (n, D) their positions [rad or m]; the others are neutral.
    """
    import pinocchio as pin

    model = robot.model
    q = np.tile(pin.neutral(model), (len(positions), 1))
    columns = {name: positions[:, d] for d, name in enumerate(joints)}
    for name, values in (neutral(robot) | columns).items():
        joint = model.joints[model.getJointId(name)]
        if joint.nq == 1:
            q[:, joint.idx_q] = values
        else:
            q[:, joint.idx_q], q[:, joint.idx_q + 1] = np.cos(values), np.sin(values)
    return q


def _joint_type(shortname: str) -> JointType | None:
    """Type of a Pinocchio joint by its short name; None for joints of several DoFs."""
    if shortname.startswith("JointModelR"):
        return "revolute"
    if shortname.startswith("JointModelP") and not shortname.startswith("JointModelPlanar"):
        return "prismatic"
    return None


def read_root(path: Path) -> ET.Element:
    """Root element of an XML file.

    Args:
        path: the file.

    Raises:
        UnreadableInputError: there is no such file, or it is no XML.
    """
    return parsed_urdf(read_description(path), str(path))


def parsed_urdf(content: bytes, source: str) -> ET.Element:
    """Root element of an XML document.

    Args:
        content: its bytes.
        source: where it came from, for messages.

    Raises:
        UnreadableInputError: it is no XML.
    """
    try:
        # Plain expat: no external entities are fetched, and its own limit stops entity bombs.
        return ET.fromstring(content)  # noqa: S314
    except (ET.ParseError, ValueError, LookupError) as error:
        raise UnreadableInputError(
            source,
            f"is not XML: {error}",
            "give a URDF file, not xacro",
            "no XML",
        ) from error


def check_tree(root: ET.Element, source: str) -> tuple[frozenset[str], tuple[str, ...]]:
    """Names of all links and of the fixed leaves of a URDF that is one tree of links.

    Args:
        root: its root element.
        source: where it came from, for messages.

    Raises:
        UnreadableInputError: it is no such URDF.
    """

    def complain(why: Unreadable, what: str) -> UnreadableInputError:
        return UnreadableInputError(source, what, "check it with check_urdf", why)

    if root.tag != "robot":
        what = f"is not a URDF: its root element is <{root.tag}>, not <robot>"
        raise complain("another format", what)
    links = [link.get("name") or "" for link in root.findall("link")]
    if not links:
        raise complain("no links", "has no links")
    if len(links) > MOST_LINKS:
        what = f"has {len(links)} links, and up to {MOST_LINKS} are read"
        raise UnreadableInputError(source, what, "give the URDF of one robot", "too large")
    repeated = [name for name, n in Counter(links).items() if n > 1 or not name]
    if repeated:
        what = f"has several links, or one without a name, called {repeated[0]!r}"
        raise complain("same name", what)
    parents: dict[str, str] = {}
    fixed: set[str] = set()
    known = set(links)
    for joint in root.findall("joint"):
        name = joint.get("name")
        parent, child = (_end(joint, end) for end in ("parent", "child"))
        for link in (parent, child):
            if link not in known:
                what = f"joint {name!r} refers to a link {link!r} that does not exist"
                raise complain("missing link", what)
        if child in parents:
            raise complain("two parents", f"link {child!r} is the child of two joints")
        parents[child] = parent
        if joint.get("type") == "fixed":
            fixed.add(child)
    roots = [link for link in links if link not in parents]
    if len(roots) != 1:
        what = f"is not one tree: {len(roots)} of its links have no parent joint"
        raise complain("several trees", what)
    hanging = set(roots)  # what is known to end in the root
    for link in links:
        above: dict[str, None] = {}
        ancestor = link
        while ancestor not in hanging:
            if ancestor in above:
                raise complain("circle", f"is not a tree: link {ancestor!r} is its own ancestor")
            above[ancestor] = None
            ancestor = parents[ancestor]
        hanging.update(above)
    inner = set(parents.values())
    leaves = tuple(link for link in links if link in fixed and link not in inner)
    return frozenset(links), leaves


def _end(joint: ET.Element, tag: str) -> str:
    """Name of the parent or child link of a joint; empty where there is none."""
    end = joint.find(tag)
    return "" if end is None else end.get("link", "")
