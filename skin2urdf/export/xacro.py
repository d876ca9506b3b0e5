"""A xacro file to include: macros that put the SUs onto the links of any description."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

from skin2urdf.export.source import ExportedSu, Source, decimal, decimals
from skin2urdf.urdf.emit import PLACEHOLDER, SU_INERTIA, SU_MASS
from skin2urdf.urdf.names import comment

_XACRO = "http://www.ros.org/wiki/xacro"


def to_xacro(source: Source) -> str:
    """SUs as xacro macros, one for each link that carries any, and ``skin`` for all of them.

    A macro takes the link it puts SUs onto as ``parent``, since the description that includes it
    may call its links otherwise, and a ``prefix`` for the names of the SUs.

    Args:
        source: what to export.

    Returns:
        The text of the file.

    Raises:
        UsageError: the log tells of no SU where it sits.
    """
    by_link: dict[str, list[ExportedSu]] = {}
    for su in source.placed_sus():
        by_link.setdefault(su.joint.parent, []).append(su)
    macros = _macro_names(list(by_link))
    ET.register_namespace("xacro", _XACRO)
    robot = ET.Element("robot", {"xmlns:xacro": _XACRO})
    for line in source.header:
        robot.append(comment(line))
    robot.append(comment('include this file, then: <xacro:skin prefix="" />, or link by link:'))
    for link, macro in macros.items():
        robot.append(comment(f'<xacro:{macro} parent="{link}" prefix="" />'))
    for link, sus in by_link.items():
        body = ET.SubElement(
            robot, "xacro:macro", name=macros[link], params=f"parent:={_literal(link)} prefix:=''"
        )
        for su in sus:
            _add(body, su)
    whole = ET.SubElement(robot, "xacro:macro", name="skin", params="prefix:=''")
    for link, macro in macros.items():
        call = {"parent": _escaped(link), "prefix": "${prefix}"}
        ET.SubElement(whole, f"xacro:{macro}", call)
    ET.indent(robot)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(robot, "unicode") + "\n"


def _add(body: ET.Element, su: ExportedSu) -> None:
    """Add the link and the fixed joint of one SU to a macro."""
    name = f"${{prefix}}{_escaped(su.name)}"
    link = ET.SubElement(body, "link", name=name)
    inertial = ET.SubElement(link, "inertial")
    inertial.append(comment(PLACEHOLDER))
    ET.SubElement(inertial, "mass", value=decimal(SU_MASS))
    moments = dict.fromkeys(("ixx", "iyy", "izz"), decimal(SU_INERTIA))
    ET.SubElement(inertial, "inertia", moments | dict.fromkeys(("ixy", "ixz", "iyz"), "0.0"))
    joint = ET.SubElement(body, "joint", name=f"${{prefix}}{_escaped(su.joint.name)}", type="fixed")
    for words in su.open_words:
        joint.append(comment(f"OPEN: {words}"))
    ET.SubElement(joint, "parent", link="${parent}")
    ET.SubElement(joint, "child", link=name)
    xyz, rpy = decimals(su.joint.xyz), decimals(su.joint.rpy)
    ET.SubElement(joint, "origin", xyz=xyz, rpy=rpy)


def _macro_names(links: list[str]) -> dict[str, str]:
    """A name that XML and xacro allow for the macro of each link."""
    names: dict[str, str] = {}
    for link in links:
        name = base = f"skin_on_{re.sub('[^A-Za-z0-9_]', '_', link)}"
        n = 1
        while name in names.values():
            n += 1
            name = f"{base}_{n}"
        names[link] = name
    return names


def _escaped(name: str) -> str:
    """A name in which xacro finds nothing to evaluate."""
    return re.sub(r"\$(?=[({$])", "$$", name)


def _literal(name: str) -> str:
    """A name as the default of a parameter."""
    return f"'{_escaped(name)}'" if re.search(r"\s", name) else _escaped(name)
