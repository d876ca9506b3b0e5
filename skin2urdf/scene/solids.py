"""Closed surfaces of triangles: prisms and ellipsoids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Int, Record

_ROUND = 14
"""Sides of what should look like a cylinder."""
_RINGS = 7
"""Rings of a sphere between its poles."""


@dataclass(frozen=True, eq=False)
class Mesh(Record):
    """A surface of triangles.

    Attributes:
        vertices: (n, 3) [m].
        faces: (m, 3) indices of vertices, counter-clockwise seen from outside.
    """

    vertices: F64
    faces: Int

    def moved(self, T: F64) -> Mesh:
        """The mesh in another frame, by (4, 4) T of its own frame there."""
        return Mesh(self.vertices @ T[:3, :3].T + T[:3, 3], self.faces)


def merged(meshes: Sequence[Mesh]) -> Mesh:
    """All meshes as one."""
    if not meshes:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]),
    )


def prism(begin: F64, end: F64, radius: float, sides: int = _ROUND) -> Mesh:
    """A regular prism between two points, closed at both ends; a rod where it has many sides.

    Args:
        begin: (3,) middle of one face [m].
        end: (3,) middle of the other face [m], another point.
        radius: distance of the corners from the middle [m].
        sides: number of its sides.
    """
    z = (end - begin) / np.linalg.norm(end - begin)
    # Any x will do that is not nearly along z.
    x = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    x /= np.linalg.norm(x)
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = radius * (np.cos(angle)[:, None] * x + np.sin(angle)[:, None] * np.cross(z, x))
    vertices = np.concatenate([begin + ring, end + ring, begin[None], end[None]])
    i = np.arange(sides)
    j = (i + 1) % sides
    low, high = np.full(sides, 2 * sides), np.full(sides, 2 * sides + 1)
    faces = np.concatenate(
        [
            np.stack([i, j, i + sides], axis=1),
            np.stack([j, j + sides, i + sides], axis=1),
            np.stack([low, j, i], axis=1),
            np.stack([high, i + sides, j + sides], axis=1),
        ]
    )
    return Mesh(vertices, faces)


def ellipsoid(center: F64, axes: F64) -> Mesh:
    """An ellipsoid, which may be flat.

    Args:
        center: (3,) its middle [m].
        axes: (3, 3) columns are its semi-axes [m].
    """
    polar = np.pi * np.arange(1, _RINGS + 1) / (_RINGS + 1)
    turn = 2 * np.pi * np.arange(_ROUND) / _ROUND
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    belt = np.concatenate(
        [np.column_stack([np.sin(p) * ring, np.full(_ROUND, np.cos(p))]) for p in polar]
    )
    sphere = np.concatenate([[[0.0, 0.0, 1.0]], belt, [[0.0, 0.0, -1.0]]])
    i = np.arange(_ROUND)
    j = (i + 1) % _ROUND
    last = 1 + _ROUND * _RINGS
    faces = [np.stack([np.zeros_like(i), 1 + i, 1 + j], axis=1)]
    for r in range(_RINGS - 1):
        upper, lower = 1 + _ROUND * r, 1 + _ROUND * (r + 1)
        faces.append(np.stack([upper + i, lower + i, upper + j], axis=1))
        faces.append(np.stack([upper + j, lower + i, lower + j], axis=1))
    bottom = last - _ROUND
    faces.append(np.stack([np.full_like(i, last), bottom + j, bottom + i], axis=1))
    if np.linalg.det(axes) < 0:
        axes = axes * np.array([1.0, 1.0, -1.0])
    return Mesh(center + sphere @ axes.T, np.concatenate(faces))
