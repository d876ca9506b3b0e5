"""Whether a robot touches itself: coal on the shapes of its URDF, through Pinocchio.

Bodies that one joint connects are not compared. Nor are pairs that touch in the neutral pose and in
nearly all others: shapes of URDFs are coarse, and such a pair says nothing of the motion.
"""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ET
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.planning.trajectory import JointTrajectory

MARGIN = 0.01
"""Distance that is kept [m]: joints stray from what they are commanded by milliradians."""
_NEARLY_ALL = 0.95
"""Share of random poses in which a pair, beside the neutral one, has to touch to count as always
touching."""
_POSES = 100
_FINE_MESH = 5000
"""Triangles from which a mesh is replaced by its convex hull."""
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

    Raises:
        ValueError, RuntimeError: shapes can not be read, as meshes that are not there.
    """

    def __init__(
        self,
        xml: ET.Element,
        path: Path,
        joint_names: Sequence[str],
        locked: Mapping[str, float],
        limits: tuple[F64, F64],
        floor: float | None = None,
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
        _simplify(self._geometry)
        self._names = tuple(joint_names)
        self._base = self._configuration(locked)
        if floor is not None:
            self._add_floor(floor)
        self.notes: list[str] = []
        self.n_pairs = self._choose_pairs(limits)
        self._reach = self._reaches()

    def is_free(self, q: F64) -> bool:
        """Whether nothing comes nearer than the margin in a pose (D,)."""
        import pinocchio as pin

        full = self._placed(q)
        return not pin.computeCollisions(
            self._model, self._data, self._geometry, self._shapes, full, True
        )

    def touches(self, q: F64) -> bool:
        """Whether bodies touch in a pose (D,), whatever the margin."""
        import pinocchio as pin

        shapes = pin.GeometryData(self._geometry)
        full = self._placed(q)
        return bool(
            pin.computeCollisions(self._model, self._data, self._geometry, shapes, full, True)
        )

    def is_path_free(self, piece: JointTrajectory) -> bool:
        """Whether nothing touches along a piece of motion, between samples as well.

        No point of a body moves further relative to another than the sum, over the joints between
        them, of what each turns times its reach. So one look at a pair tells that it does not touch
        as long as it moves less than it is apart. The middle is looked at first, and then halves,
        with the pairs that it leaves open.
        """
        import pinocchio as pin

        if not self.n_pairs:
            return True
        time = np.append(np.arange(0.0, piece.duration, _FINE), piece.duration)
        moved = np.abs(np.diff(piece.at(time)[0], axis=0)) @ self._reach.max(axis=0)
        length = np.concatenate([[0.0], np.cumsum(moved)])
        n = int(np.ceil(length[-1] / (2 * MARGIN))) + 1
        at = np.interp(np.linspace(0.0, length[-1], n + 1), length, time)
        q = piece.at(at)[0]
        turned = np.concatenate([np.zeros((1, q.shape[1])), np.abs(np.diff(q, axis=0))])
        way = np.cumsum(turned, axis=0) @ self._reach.T
        open_ = deque([(0, n, np.arange(self.n_pairs))])
        while open_:
            first, last, pairs = open_.popleft()
            middle = (first + last) // 2
            pin.updateGeometryPlacements(
                self._model, self._data, self._geometry, self._shapes, self._placed(q[middle])
            )
            apart = np.empty(len(pairs))
            for i, pair in enumerate(pairs.tolist()):
                if pin.computeCollision(self._geometry, self._shapes, pair):
                    return False
                # Bounds are on what is left beyond the margin.
                apart[i] = MARGIN + self._shapes.collisionResults[pair].distance_lower_bound
            here = way[middle, pairs]
            for a, b in ((first, middle - 1), (middle + 1, last)):
                if a <= b:
                    farthest = np.maximum(np.abs(way[a, pairs] - here), way[b, pairs] - here)
                    left = pairs[farthest > apart]
                    if len(left):
                        open_.append((a, b, left))
        return True

    def _configuration(self, positions: Mapping[str, float]) -> F64:
        import pinocchio as pin

        q = np.array(pin.neutral(self._model))
        for name, value in positions.items():
            self._put(q, name, value)
        return q

    def _put(self, q: F64, name: str, value: float) -> None:
        joint = self._model.joints[self._model.getJointId(name)]
        if joint.nv == 1 and joint.nq == 2:
            q[joint.idx_q : joint.idx_q + 2] = np.cos(value), np.sin(value)
        elif joint.nv == 1:
            q[joint.idx_q] = value

    def _placed(self, q: F64) -> F64:
        full = self._base.copy()
        for name, value in zip(self._names, q, strict=True):
            self._put(full, name, float(value))
        return full

    def _moving_ancestor(self, joint: int) -> int:
        """The last joint that moves at or before one of the full model; 0 for the base."""
        while joint and self._model.names[joint] not in self._names:
            joint = int(self._model.parents[joint])
        return joint

    def _add_floor(self, height: float) -> None:
        import coal
        import pinocchio as pin

        below = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
        at = pin.SE3(np.eye(3), np.array([0.0, 0.0, height]))
        self._geometry.addGeometryObject(pin.GeometryObject(_FLOOR, 0, 0, at, below))

    def _choose_pairs(self, limits: tuple[F64, F64]) -> int:
        import pinocchio as pin

        objects = list(self._geometry.geometryObjects)
        group = [self._moving_ancestor(int(o.parentJoint)) for o in objects]
        before = {g: self._moving_ancestor(int(self._model.parents[g])) if g else -1 for g in group}
        pairs = [
            (a, b)
            for a in range(len(objects))
            for b in range(a + 1, len(objects))
            if group[b] not in (group[a], before[group[a]])
            and before[group[b]] != group[a]
            and before[group[a]] != group[b]
            and before[group[b]] != group[a]
        ]
        self._geometry.removeAllCollisionPairs()
        for a, b in pairs:
            self._geometry.addCollisionPair(pin.CollisionPair(a, b))
        self._ready()
        low, high = (np.clip(x, -np.pi, np.pi) for x in limits)
        rng = np.random.default_rng(0)
        neutral = np.clip(np.zeros(len(self._names)), *limits)
        poses = [neutral, *rng.uniform(low, high, (_POSES, len(self._names)))]
        touches = np.array([self._touching(q) for q in poses], dtype=bool)
        always = touches[0] & (touches[1:].mean(axis=0) >= _NEARLY_ALL)
        self._geometry.removeAllCollisionPairs()
        for (a, b), drop in zip(pairs, always, strict=True):
            if not drop:
                self._geometry.addCollisionPair(pin.CollisionPair(a, b))
        self._ready()
        if always.any():
            named = [
                f"{objects[a].name} and {objects[b].name}"
                for (a, b), drop in zip(pairs, always, strict=True)
                if drop
            ]
            more = f" and {len(named) - 4} more pairs" if len(named) > 4 else ""
            self.notes.append(
                f"not kept apart, for they touch in the neutral pose and nearly everywhere: "
                f"{', '.join(named[:4])}{more}"
            )
        return int(len(pairs) - always.sum())

    def _ready(self) -> None:
        import pinocchio as pin

        self._data: Any = self._model.createData()
        self._shapes: Any = pin.GeometryData(self._geometry)
        for request in self._shapes.collisionRequests:
            request.security_margin = MARGIN

    def _touching(self, q: F64) -> list[bool]:
        import pinocchio as pin

        full = self._placed(q)
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


def _simplify(geometry: Any) -> None:
    """Put convex hulls in the place of fine meshes, which they contain and are faster than."""
    for shape in geometry.geometryObjects:
        mesh = shape.geometry
        if getattr(mesh, "num_tris", 0) > _FINE_MESH:
            mesh.buildConvexHull(True, "Qt")
            shape.geometry = mesh.convex or mesh


def _slides(joint: Any) -> bool:
    return "Prismatic" in joint.shortname() or joint.shortname().startswith("JointModelP")
