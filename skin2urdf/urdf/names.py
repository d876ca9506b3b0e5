"""Names and words in a URDF: names are unique, and those of the log wherever possible."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, cast

from skin2urdf.errors import UsageError
from skin2urdf.structure.records import KinematicTree

BASE_LINK = "base_link"

NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""What XML 1.0 has no way to write, not even escaped."""


def comment(words: str) -> ET.Element:
    """A comment in XML, which allows no two hyphens in a row in it, nor one at its end."""
    safe = NOT_XML.sub("?", words)
    while "--" in safe:
        safe = safe.replace("--", "- -")
    element: Any = ET.Comment(f" {safe} ")  # an element whose tag is a function
    return cast("ET.Element", element)


@dataclass(frozen=True)
class UrdfNames:
    """Names in the URDF of a tree with D joints and U SUs.

    Attributes:
        joint_links: D names of the links that the joints carry.
        su_links: U names of the SUs' links, the SUs' own names unless those clash.
        su_joints: U names of the fixed joints that hold the SUs.
    """

    joint_links: tuple[str, ...]
    su_links: tuple[str, ...]
    su_joints: tuple[str, ...]


def urdf_names(tree: KinematicTree) -> UrdfNames:
    """Name all links and fixed joints of a tree.

    Joints keep the names they have in the log. SUs keep theirs unless they clash with
    ``base_link``, a joint (frames of both kinds share a name space in Pinocchio) or another SU;
    made-up names give way to all of those.

    Args:
        tree: the structure.

    Returns:
        The names; links are unique among links and joints, joints among joints.

    Raises:
        UsageError: a name is empty or has characters that no XML file can hold, or two joints
            have the same name.
    """
    for kind, names in (("joint", tree.joint_names), ("SU", tree.su_names)):
        for name in names:
            if not name.strip() or NOT_XML.search(name):
                raise UsageError(
                    f"the {kind} name {name!r} can not be written to a URDF",
                    "rename it in the driver that publishes it",
                )
    taken = {BASE_LINK}
    for name in tree.joint_names:
        if name in taken - {BASE_LINK}:
            raise UsageError(f"two joints are named {name!r}", "give each joint a name of its own")
        taken.add(name)
    su_links = _unique(tree.su_names, "_su", taken)
    joint_links = _unique((f"{name}_link" for name in tree.joint_names), "", taken)
    su_joints = _unique((f"{name}_mount" for name in su_links), "", taken)
    return UrdfNames(joint_links, su_links, su_joints)


def _unique(names: Iterable[str], suffix: str, taken: set[str]) -> tuple[str, ...]:
    """Give each name that is already in ``taken`` a suffix and a number; add all to ``taken``."""
    result = []
    for name in names:
        candidate, n = name, 1
        while candidate in taken:
            candidate = f"{name}{suffix}" if n == 1 and suffix else f"{name}{suffix}_{n}"
            n += 1
        taken.add(candidate)
        result.append(candidate)
    return tuple(result)
