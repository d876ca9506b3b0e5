"""Whether a robot touches itself: coal on the shapes of its URDF, through Pinocchio.

Bodies that one joint connects are not compared. Nor are pairs that touch in the neutral pose and in
nearly all others: shapes of URDFs are coarse, and such a pair says nothing of the motion. But a
floor is given by somebody: all that moves keeps above it, and where a link can not, that is an
error.
"""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.errors import UsageError
from skin2urdf.planning.trajectory import JointTrajectory

MARGIN = 0.01
"""Distance that is kept [m]: joints stray from what they are commanded by milliradians."""
_NEARLY_ALL = 0.95
"""Share of random poses in which a pair, beside the neutral one, has to touch to count as always
touching."""
_POSES = 100
_FINE_MESH = 5000
"""Triangles from which a mesh is replaced by its convex hull."""
_NAMED = 4
"""Pairs or links that are named in words, at most."""
_LOOKS = 15
"""Instants of a piece that are looked at first, since one that touches is found at once."""
_FLOOR = "the floor"
_FINE = 5e-3
"""Time between samples that the length of a path is measured at [s]."""


class CollisionChecker:
    """Keeps a robot's bodies apart.

    Args:
        xml: the URDF.
        path: where it was read from; meshes are looked for relative to the folders above it.
        joint_names: D joints that move.
        locked: positions of all others [rad or m].
        limits: (lower, upper) positions (D,) that random poses are drawn from.
        floor: height in the base frame that no moving body goes below [m]; None without a floor.
        may_touch: pairs of links that are not kept apart.

    Attributes:
        n_pairs: pairs of bodies that are kept apart.
        notes: which are not, though nobody said so.
        crowded: those that are near each other in most of random poses, in words.

    Raises:
        ValueError, RuntimeError: shapes can not be read, as meshes that are not there.
        UsageError: the floor is no number, nothing that moves has a shape to keep above it, or
            what does is below it in the neutral pose and nearly everywhere.
    """

    def __init__(
        self,
        xml: ET.Element,
        path: Path,
        joint_names: Sequence[str],
        locked: Mapping[str, float],
        limits: tuple[F64, F64],
        floor: float | None = None,
        may_touch: Collection[frozenset[str]] = (),
    ) -> None:
        import pinocchio as pin

        text = ET.tostring(xml, encoding="unicode")
        self._model = pin.buildModelFromXML(text)
        folders = [str(folder) for folder in path.resolve().parents]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self._geometry = pin.buildGeomFromUrdfString(
                self._model, text, pin.GeometryType.COLLISION, package_dirs=folders
            )
        _simplify(self._geometry, _FINE_MESH)
        self._names = tuple(joint_names)
        self._columns = _Columns.of(self._model, self._names)
        self._base = self._configuration(locked)
        if floor is not None:
            self._add_floor(floor)
        self.notes: list[str] = []
        self.crowded: tuple[str, ...] = ()
        self.n_pairs = self._choose_pairs(limits, may_touch)
        self._reach = self._reaches()
        self._hulls = self._geometry.copy()
        _simplify(self._hulls, 0)
        self._bare: Any = pin.GeometryData(self._hulls), pin.GeometryData(self._geometry)
        self._within: Any = pin.GeometryData(self._hulls)
        for request in self._within.collisionRequests:
            request.security_margin = MARGIN

    def is_free(self, q: F64) -> bool:
        """Whether nothing comes nearer than the margin in a pose (D,)."""
        import pinocchio as pin

        full = self._placed(q[None])[0]
        return not all(
            pin.computeCollisions(self._model, self._data, geometry, shapes, full, True)
            for geometry, shapes in ((self._hulls, self._within), (self._geometry, self._shapes))
        )

    def touches(self, q: F64) -> bool:
        """Whether bodies touch in a pose (D,), whatever the margin."""
        import pinocchio as pin

        full = self._placed(q[None])[0]
        return all(
            pin.computeCollisions(self._model, self._data, geometry, shapes, full, True)
            for geometry, shapes in zip((self._hulls, self._geometry), self._bare, strict=True)
        )

    def is_path_free(self, piece: JointTrajectory) -> bool:
        """Whether nothing touches along a piece of motion, between samples as well.

        No point of a body moves further relative to another than the sum, over the joints between
        them, of what each turns times its reach. So one look at a pair tells of all instants in
        which the joints are so near to where they were looked at that it moves less than it is
        apart: of all of a pattern that swings about a pose, often. Instants are looked at in
        halves of halves, each with the pairs that are left open there.
        """
        if not self.n_pairs:
            return True
        time = np.append(np.arange(0.0, piece.duration, _FINE), piece.duration)
        fine = piece.at(time)[0]
        told = fine[len(time) // 2]
        apart = self._apart(self._placed(told[None])[0], np.arange(self.n_pairs))
        if apart is None:
            return False
        # A pair that none of the joints can bring together needs no further look.
        pairs = np.flatnonzero(self._reach @ np.abs(fine - told).max(axis=0) > apart)
        if not len(pairs):
            return True
        coarse = self._placed(fine[:: max(1, len(time) // _LOOKS)])
        if any(self._apart(coarse[i], pairs) is None for i in _in_halves(len(coarse))):
            return False
        reach = self._reach[pairs]
        moved = (np.abs(np.diff(fine, axis=0)) @ np.unique(reach, axis=0).T).max(axis=1)
        length = np.concatenate([[0.0], np.cumsum(moved)])
        n = int(np.ceil(length[-1] / (2 * MARGIN))) + 1
        at = np.interp(np.linspace(0.0, length[-1], n + 1), length, time)
        q = piece.at(at)[0]
        full = self._placed(q)
        # What lies between two instants is told with the nearer one, half of the way to it.
        step = np.abs(np.diff(q, axis=0, prepend=q[:1], append=q[-1:]))
        beside = reach @ (0.5 * np.maximum(step[:-1], step[1:])).T
        is_open = reach @ np.abs(q - told).T + beside > apart[pairs, None]
        for i in _in_halves(n + 1):
            open_ = np.flatnonzero(is_open[:, i])
            if not len(open_):
                continue
            found = self._apart(full[i], pairs[open_])
            if found is None:
                return False
            away = reach[open_] @ np.abs(q - q[i]).T
            is_open[open_] &= away + beside[open_] > found[:, None]
            is_open[open_, i] = False
        return True

    def _apart(self, full: F64, pairs: Int) -> F64 | None:
        """(n,) distances [m] that n pairs have at least in a configuration; None where one touches.

        Hulls are looked at first: that they are apart is found faster, and their bodies are at
        least as far from each other.
        """
        import pinocchio as pin

        pin.updateGeometryPlacements(self._model, self._data, self._hulls, self._within, full)
        apart = np.empty(len(pairs))
        exact = False
        for k, pair in enumerate(pairs.tolist()):
            shapes = self._within
            if pin.computeCollision(self._hulls, shapes, pair):
                shapes = self._shapes
                if not exact:
                    pin.updateGeometryPlacements(self._model, self._data, self._geometry, shapes)
                    exact = True
                if pin.computeCollision(self._geometry, shapes, pair):
                    return None
            # Bounds are on what is left beyond the margin.
            apart[k] = MARGIN + shapes.collisionResults[pair].distance_lower_bound
        return apart

    def _configuration(self, positions: Mapping[str, float]) -> F64:
        import pinocchio as pin

        full = np.array(pin.neutral(self._model))[None]
        columns = _Columns.of(self._model, tuple(positions))
        columns.fill(full, np.array([[*positions.values()]], dtype=np.float64))
        return np.asarray(full[0])

    def _placed(self, q: F64) -> F64:
        """(N, nq) configurations of the whole model from positions (N, D)."""
        full = np.tile(self._base, (len(q), 1))
        self._columns.fill(full, q)
        return full

    def _moving_ancestor(self, joint: int) -> int:
        """The last joint that moves at or before one of the full model; 0 for the base."""
        while joint and self._model.names[joint] not in self._names:
            joint = int(self._model.parents[joint])
        return joint

    def _add_floor(self, height: float) -> None:
        import coal
        import pinocchio as pin

        if not np.isfinite(height):
            raise UsageError(
                f"--floor {height:g} is no height", "give it in the base frame [m]", "--floor"
            )
        below = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
        at = pin.SE3(np.eye(3), np.array([0.0, 0.0, height]))
        self._geometry.addGeometryObject(pin.GeometryObject(_FLOOR, 0, 0, at, below))

    def _choose_pairs(self, limits: tuple[F64, F64], may_touch: Collection[frozenset[str]]) -> int:
        import pinocchio as pin

        objects = list(self._geometry.geometryObjects)
        is_floor = [str(o.name) == _FLOOR for o in objects]
        link = [
            _FLOOR if floor else str(self._model.frames[int(o.parentFrame)].name)
            for o, floor in zip(objects, is_floor, strict=True)
        ]
        group = [self._moving_ancestor(int(o.parentJoint)) for o in objects]
        before = {g: self._moving_ancestor(int(self._model.parents[g])) if g else -1 for g in group}
        pairs = [
            (a, b)
            for a in range(len(objects))
            for b in range(a + 1, len(objects))
            if group[a] != group[b]
            # A joint on the base does not connect what it moves with the floor.
            and (is_floor[a] or is_floor[b] or not _joined(group[a], group[b], before))
            and frozenset((link[a], link[b])) not in may_touch
        ]
        if any(is_floor) and not any(is_floor[a] or is_floor[b] for a, b in pairs):
            raise UsageError(
                "nothing that moves has a shape that --floor could keep above it",
                "give links that move <collision> shapes, or leave out --floor",
                argument="--floor",
            )
        self._geometry.removeAllCollisionPairs()
        for a, b in pairs:
            self._geometry.addCollisionPair(pin.CollisionPair(a, b))
        self._ready()
        low, high = (np.clip(x, -np.pi, np.pi) for x in limits)
        rng = np.random.default_rng(0)
        neutral = np.clip(np.zeros(len(self._names)), *limits)
        poses = [neutral, *rng.uniform(low, high, (_POSES, len(self._names)))]
        touches = np.array([self._touching(q) for q in poses], dtype=bool)
        often = touches[1:].mean(axis=0)
        always = touches[0] & (often >= _NEARLY_ALL)
        self._check_floor([pair for pair, drop in zip(pairs, always, strict=True) if drop], link)
        self._geometry.removeAllCollisionPairs()
        for (a, b), drop in zip(pairs, always, strict=True):
            if not drop:
                self._geometry.addCollisionPair(pin.CollisionPair(a, b))
        self._ready()
        if len(pairs):
            worst = np.argsort(-np.where(always, 0.0, often), kind="stable")[:_NAMED]
            self.crowded = tuple(
                f"{_both(link, pairs[k])} in {100 * often[k]:.0f} % of random poses"
                for k in worst.tolist()
                if not always[k] and often[k] > 0
            )
        if always.any():
            named = [_both(link, pair) for pair, drop in zip(pairs, always, strict=True) if drop]
            self.notes.append(
                "not kept apart, for they touch in the neutral pose and nearly everywhere: "
                f"{_few(named, 'pairs')}"
            )
        return int(len(pairs) - always.sum())

    def _check_floor(self, always: Sequence[tuple[int, int]], link: Sequence[str]) -> None:
        """Refuse a floor that is part of pairs that always touch."""
        pairs = ({link[a], link[b]} for a, b in always)
        below = sorted({name for pair in pairs if _FLOOR in pair for name in pair - {_FLOOR}})
        if below:
            raise UsageError(
                f"--floor is too high for {_few(below, 'links')}, which would be below it in the "
                "neutral pose and nearly everywhere",
                "give the height in the base frame [m] that the robot stays above, with 1 cm to "
                "spare; it is negative for a floor below the base",
                argument="--floor",
            )

    def _ready(self) -> None:
        import pinocchio as pin

        self._data: Any = self._model.createData()
        self._shapes: Any = pin.GeometryData(self._geometry)
        for request in self._shapes.collisionRequests:
            request.security_margin = MARGIN

    def _touching(self, q: F64) -> list[bool]:
        import pinocchio as pin

        full = self._placed(q[None])[0]
        pin.computeCollisions(self._model, self._data, self._geometry, self._shapes, full, False)
        return [bool(result.isCollision()) for result in self._shapes.collisionResults]

    def _reaches(self) -> F64:
        """(pairs, D) farthest that what moves of a pair's two bodies can be from a joint [m].

        It is 1 for slides, and 0 where a joint moves both bodies or none.
        """
        model = self._model
        objects = list(self._geometry.geometryObjects)
        index = {int(model.getJointId(name)): d for d, name in enumerate(self._names)}
        reach = np.zeros((len(objects), len(self._names)))
        for shape, row in zip(objects, reach, strict=True):
            if shape.name == _FLOOR:
                continue
            shape.geometry.computeLocalAABB()
            center = shape.placement.act(np.array(shape.geometry.aabb_center))
            far = float(np.linalg.norm(center)) + float(shape.geometry.aabb_radius)
            joint = int(shape.parentJoint)
            while joint:
                slides = model.joints[joint].nv == 1 and _slides(model.joints[joint])
                if joint in index:
                    row[index[joint]] = 1.0 if slides else far
                if slides:
                    at = model.joints[joint].idx_q
                    ends = np.array([model.lowerPositionLimit[at], model.upperPositionLimit[at]])
                    far += float(np.abs(ends[np.isfinite(ends)]).max(initial=0.0))
                far += float(np.linalg.norm(model.jointPlacements[joint].translation))
                joint = int(model.parents[joint])
        pairs = [(int(p.first), int(p.second)) for p in self._geometry.collisionPairs]
        first, second = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
        a, b = reach[first], reach[second]
        return np.where((a > 0) & (b > 0), 0.0, a + b)


@dataclass(frozen=True, eq=False)
class _Columns:
    """Where positions of joints of one DoF stand in a configuration of the whole model.

    Attributes:
        plain: pairs of (position, column), and
        turning: those of joints that turn without end, whose cosine stands there and sine behind.
    """

    plain: tuple[Int, Int]
    turning: tuple[Int, Int]

    @classmethod
    def of(cls, model: Any, names: Sequence[str]) -> _Columns:
        joints = [model.joints[model.getJointId(name)] for name in names]

        def where(nq: int) -> tuple[Int, Int]:
            own = [(d, j.idx_q) for d, j in enumerate(joints) if (j.nv, j.nq) == (1, nq)]
            position, column = np.array(own, dtype=np.int64).reshape(-1, 2).T
            return position, column

        return cls(where(1), where(2))

    def fill(self, full: F64, q: F64) -> None:
        """Write positions (N, D) into configurations (N, nq)."""
        position, column = self.plain
        full[:, column] = q[:, position]
        position, column = self.turning
        full[:, column], full[:, column + 1] = np.cos(q[:, position]), np.sin(q[:, position])


def _joined(a: int, b: int, before: Mapping[int, int]) -> bool:
    """Whether one joint connects two groups of bodies, by the group before each of them."""
    return before[a] == b or before[b] == a


def _few(names: Sequence[str], what: str) -> str:
    """Names in words, the first ones alone where there are many."""
    rest = len(names) - _NAMED
    return ", ".join(names[:_NAMED]) + (f" and {rest} more {what}" if rest > 0 else "")


def _both(links: Sequence[str], pair: tuple[int, int]) -> str:
    """Names of the links of a pair."""
    return f"{links[pair[0]]} and {links[pair[1]]}"


def _simplify(geometry: Any, most: int) -> None:
    """Put convex hulls in the place of meshes of more triangles, which they contain."""
    for shape in geometry.geometryObjects:
        mesh = shape.geometry
        if getattr(mesh, "num_tris", 0) > most:
            with suppress(RuntimeError):  # a corner of a hull may have 255 neighbours at most
                mesh.buildConvexHull(True, "Qt")
                shape.geometry = mesh.convex or mesh


def _in_halves(n: int) -> Iterator[int]:
    """0 .. n - 1, the middle first, then the middles of both halves, and so on."""
    spans = [(0, n)]
    for first, end in spans:
        if first < end:
            middle = (first + end) // 2
            yield middle
            spans += [(first, middle), (middle + 1, end)]


def _slides(joint: Any) -> bool:
    return "Prismatic" in joint.shortname() or joint.shortname().startswith("JointModelP")
