"""A vendor's text with what was found: nothing but what is added or corrected changes a byte."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.errors import UnreadableInputError, UsageError
from skin2urdf.urdf.rpy import rpy_of_rotation

_ATTRIBUTE = re.compile(rb"""\s([\w:.-]+)\s*=\s*("[^"]*"|'[^']*')""")


@dataclass(frozen=True, eq=False)
class Attachment(Record):
    """An SU to be added.

    Attributes:
        name: of its link.
        mount: of the fixed joint that holds it.
        link: the vendor's link that it sits on.
        T_link_su: (4, 4) its frame in that link's [m].
    """

    name: str
    mount: str
    link: str
    T_link_su: F64


def with_additions(
    text: str,
    source: str,
    attachments: Sequence[Attachment],
    origins: Mapping[str, F64],
    parents: Mapping[str, str] | None = None,
) -> str:
    """The text of a URDF with SUs added and origins replaced.

    Args:
        text: the URDF.
        source: where it came from, for messages.
        attachments: the SUs, added before the end of the robot.
        origins: (4, 4) new origin of joints, by name; only their numbers change.
        parents: other links that joints hang on, by name.

    Raises:
        UnreadableInputError: the text is no XML.
        UsageError: a number is none.
    """
    for T in (*origins.values(), *(each.T_link_su for each in attachments)):
        if not np.isfinite(T).all():
            raise UsageError("a placement is not a number", "record more motion")
    data = text.encode()
    places = _places(data, source)
    changes = [_origin_change(data, places, name, T) for name, T in origins.items()]
    changes += [_parent_change(data, places, *item) for item in (parents or {}).items()]
    newline = "\r\n" if "\r\n" in text else "\n"
    lines = [line for each in attachments for line in _lines(each)]
    added = newline.join(lines) + newline if lines else ""
    begin = places.line_start(data, places.end)
    changes.append((begin, begin, added.encode()))
    for first, last, new in sorted(changes, reverse=True):
        data = data[:first] + new + data[last:]
    return data.decode()


@dataclass
class _Places:
    """Where things stand in a text [bytes].

    Attributes:
        joint: begin of each joint's tag.
        origin: begin of each joint's origin, of those that have one.
        parent: begin of each joint's parent.
        end: begin of the closing tag of the robot.
    """

    joint: dict[str, int]
    origin: dict[str, int]
    parent: dict[str, int]
    end: int

    @staticmethod
    def line_start(data: bytes, at: int) -> int:
        """Begin of a line if nothing but blanks stands between it and a place."""
        begin = data.rfind(b"\n", 0, at) + 1
        return begin if not data[begin:at].strip() else at


def _places(data: bytes, source: str) -> _Places:
    found = _Places({}, {}, {}, -1)
    path: list[str] = []
    joint = ""
    parser = expat.ParserCreate()
    # A byte order mark is no part of what expat counts from.
    mark = 3 if data.startswith(b"\xef\xbb\xbf") else 0

    def begin(tag: str, attributes: dict[str, str]) -> None:
        nonlocal joint
        path.append(tag)
        if path == ["robot", "joint"]:
            joint = attributes.get("name", "")
            found.joint[joint] = parser.CurrentByteIndex
        elif path == ["robot", "joint", "origin"]:
            found.origin.setdefault(joint, parser.CurrentByteIndex)
        elif path == ["robot", "joint", "parent"]:
            found.parent.setdefault(joint, parser.CurrentByteIndex)

    def end(_tag: str) -> None:
        if path == ["robot"]:
            found.end = parser.CurrentByteIndex
        path.pop()

    parser.StartElementHandler = begin
    parser.EndElementHandler = end
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise UnreadableInputError(source, f"is not XML: {error}", "give a URDF file") from error
    if mark and not data[found.end :].startswith(b"</"):
        found.end += mark
        found.joint = {name: at + mark for name, at in found.joint.items()}
        found.origin = {name: at + mark for name, at in found.origin.items()}
        found.parent = {name: at + mark for name, at in found.parent.items()}
    return found


def _origin_change(data: bytes, places: _Places, name: str, T: F64) -> tuple[int, int, bytes]:
    """First and last byte to replace, and what with, for another origin of a joint."""
    numbers = {b"xyz": _numbers(T[:3, 3]), b"rpy": _numbers(rpy_of_rotation(T[:3, :3]))}
    if name not in places.origin:
        at = _tag_end(data, places.joint[name])
        new = f'<origin xyz="{numbers[b"xyz"]}" rpy="{numbers[b"rpy"]}"/>'
        return at, at, new.encode()
    first = places.origin[name]
    last = _tag_end(data, first)
    return first, last, _with_attributes(data[first:last], numbers)


def _parent_change(data: bytes, places: _Places, name: str, link: str) -> tuple[int, int, bytes]:
    """First and last byte to replace, and what with, for another link that a joint hangs on."""
    first = places.parent[name]
    last = _tag_end(data, first)
    return first, last, _with_attributes(data[first:last], {b"link": quoteattr(link)[1:-1]})


def _with_attributes(tag: bytes, values: Mapping[bytes, str]) -> bytes:
    """A tag with other values of attributes, each in the quotes that it has."""
    for attribute, value in values.items():
        old = next((m for m in _ATTRIBUTE.finditer(tag) if m.group(1) == attribute), None)
        if old is not None:
            begin, end = old.span(2)
            tag = tag[: begin + 1] + value.encode() + tag[end - 1 :]
        else:
            close = len(tag) - (2 if tag.endswith(b"/>") else 1)
            head = tag[:close].rstrip()
            tag = head + b" " + attribute + b'="' + value.encode() + b'"' + tag[len(head) :]
    return tag


def _tag_end(data: bytes, begin: int) -> int:
    """First byte behind a tag; quoted values may hold any character."""
    quote = b""
    for at in range(begin, len(data)):
        here = data[at : at + 1]
        if quote:
            quote = b"" if here == quote else quote
        elif here in (b'"', b"'"):
            quote = here
        elif here == b">":
            return at + 1
    return len(data)


def _lines(each: Attachment) -> list[str]:
    """An SU's link and joint."""
    T = each.T_link_su
    xyz, rpy = _numbers(T[:3, 3]), _numbers(rpy_of_rotation(T[:3, :3]))
    return [
        f"  <link name={quoteattr(each.name)}/>",
        f'  <joint name={quoteattr(each.mount)} type="fixed">',
        f'    <origin xyz="{xyz}" rpy="{rpy}"/>',
        f"    <parent link={quoteattr(each.link)}/>",
        f"    <child link={quoteattr(each.name)}/>",
        "  </joint>",
    ]


def _numbers(values: F64) -> str:
    """Numbers parted by spaces that read back as the same float64; -0 as 0."""
    return " ".join(repr(float(value) + 0.0) for value in values)
