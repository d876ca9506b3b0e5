"""make_plan(): limits, and a model where there is one, to a motion worth recording."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.errors import PlanError
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.model.records import KinematicModel
from skin2urdf.model.specific_force import first_order, specific_forces
from skin2urdf.planning.collisions import CollisionChecker
from skin2urdf.planning.earlier import Earlier
from skin2urdf.planning.information import (
    Criterion,
    Known,
    choose,
    known_before,
    pattern_information,
    spread_out,
)
from skin2urdf.planning.limits import scaled
from skin2urdf.planning.patterns import (
    draw_tones,
    largest_amplitudes,
    pattern,
    waveform,
)
from skin2urdf.planning.pieces import rest, slowed, strain, transfer
from skin2urdf.planning.poses import free_poses, pose_range
from skin2urdf.planning.records import Limits, Phase, PhaseKind, Plan, PlanSettings
from skin2urdf.planning.roadmap import Roadmap
from skin2urdf.planning.trajectory import JointTrajectory, joined

_FEWEST = 5
"""Poses of a plan, at least: each tells of every joint, several of what they have in common."""
_FEWEST_MORE = 3
"""The same of a plan that adds to an earlier recording."""
_MOST = 9
"""Poses beyond which patterns become longer instead: more poses are more transfers and rests. In
two minutes, 7, 9 and 12 poses give a panda 0.039, 0.036 and 0.038 mm."""
_ROOM = 0.99
"""Share of a limit that is planned for where peaks depend on how long a pattern lasts."""
_FULL = 0.9
"""Share of the accelerometers' range that readings may take; their biases take the rest."""
_STEP = (0.9, 0.2)
"""Structural move [rad, m]: gravity turns by most of its size."""
_LEAST_STEP = 0.3
"""Least share of it."""
_SHARES = (1.0, 0.6, 0.3)
"""Sizes of patterns that are tried where something would touch, over the largest: what they tell
falls with the square, and with the last to what a short pattern of full size tells."""
_START = 0
"""Index of the pose that structural moves end in among those of the roadmap."""
_HOMES = 12
"""Poses that structural moves may begin in."""
_MANY = 15
"""Joints from which choosing poses takes long: fewer candidates, no exchanges."""
_UNKNOWN_REACH = 1.0
"""Lever arm that is assumed of robots without a model [m]."""

Tell = Callable[[float], None]
Move = tuple[tuple[PhaseKind, int], JointTrajectory]
"""A piece of motion, what it is, and the joint that moves alone (-1 for none)."""


def make_plan(
    limits: Limits,
    settings: PlanSettings,
    model: KinematicModel | None = None,
    checker: CollisionChecker | None = None,
    earlier: Earlier | None = None,
    tell: Tell = lambda _: None,
) -> Plan:
    """Plan a motion to record.

    Args:
        limits: what the joints may do.
        settings: choices.
        model: the robot, its base as it stands, with SUs; its joints in the order of the limits.
        checker: keeps its bodies apart.
        earlier: what is known of it, whose largest uncertainties are to shrink.
        tell: told the share of the work that is done.

    Raises:
        PlanError: there is no such motion.
    """
    work = _Planner(limits, settings, model, checker, earlier)
    return work.plan(tell)


class _Planner:
    """The state of planning: tones, candidates and what they tell."""

    def __init__(
        self,
        limits: Limits,
        settings: PlanSettings,
        model: KinematicModel | None,
        checker: CollisionChecker | None,
        earlier: Earlier | None,
    ) -> None:
        self.given, self.settings, self.model, self.earlier = limits, settings, model, earlier
        self.limits = scaled(limits, settings.share)
        self.checker = checker
        self.rng = np.random.default_rng(settings.seed)
        self.tones = draw_tones(limits.n_joints, settings.band, self.rng)
        self.fewest = _FEWEST if earlier is None else _FEWEST_MORE
        self.notes: list[str] = []

    def plan(self, tell: Tell) -> Plan:
        least = max(self.settings.least_pattern, self.tones.apart)
        self.largest, swing = largest_amplitudes(self.tones, self.limits, self.settings, least)
        low, high = pose_range(self.limits, self.settings, swing)
        many = self.limits.n_joints >= _MANY
        number = self.settings.candidates // (2 if many else 1)
        candidates = free_poses(low, high, number, self._is_free, self.rng, self._crowded)
        tell(0.2)
        if self.earlier is None:
            moves = self._structural(candidates, low, high)
        else:  # the structure is known
            moves = [(("rest", -1), self._rest(candidates[0], self.settings.rest))]
        tell(0.3)
        taken = sum(piece.duration for _, piece in moves)
        count, length = self._share_out(candidates, taken, least)
        nodes = np.concatenate([moves[-1][1].position[-1:], candidates])
        roadmap = Roadmap(nodes, self.limits, self._is_path_free)
        amplitude = self._amplitudes(nodes, length)
        tell(0.4)
        chosen = self._best(roadmap, nodes, amplitude, count, length)
        tell(0.8)
        ways = self._visited(roadmap, chosen)
        return self._assembled(moves, nodes[chosen], amplitude[chosen], ways, least)

    def _is_free(self, q: F64) -> bool:
        return self.checker is None or self.checker.is_free(q)

    @property
    def _crowded(self) -> str:
        """Which bodies are in each other's way most, in brackets; empty where none is."""
        return f" ({', '.join(self.checker.crowded)})" if self.checker else ""

    def _is_path_free(self, piece: JointTrajectory) -> bool:
        return self.checker is None or self.checker.is_path_free(piece)

    def _rest(self, pose: F64, duration: float) -> JointTrajectory:
        return rest(self.limits.joint_names, pose, duration)

    def _structural(self, candidates: F64, low: F64, high: F64) -> list[Move]:
        """One move of each joint alone with a rest behind it."""
        middle = np.linalg.norm((candidates - 0.5 * (low + high)) / (high - low), axis=1)
        best: tuple[list[int], list[Move]] | None = None
        for home in candidates[np.argsort(middle)[:_HOMES]]:
            moves: list[Move] = [(("rest", -1), self._rest(home, self.settings.rest))]
            here, left_out = home, []
            for joint in range(self.limits.n_joints):
                piece = self._move_alone(here, joint, low, high)
                if piece is None:
                    left_out.append(joint)
                    continue
                here = piece.position[-1]
                moves.append((("structural", joint), piece))
                moves.append((("rest", -1), self._rest(here, self.settings.settle)))
            if best is None or len(left_out) < len(best[0]):
                best = left_out, moves
            if not left_out:
                break
        if best is None:
            raise PlanError("there is no pose to begin in", "widen the limits of positions")
        left_out, moves = best
        if left_out:
            names = ", ".join(self.limits.joint_names[joint] for joint in left_out)
            self.notes.append(
                f"not moved alone, for something would touch: {names}; patterns move them"
            )
        return moves

    def _move_alone(self, here: F64, joint: int, low: F64, high: F64) -> JointTrajectory | None:
        """The largest free move of one joint, towards the side with more room first."""
        full = _STEP[int(self.limits.prismatic[joint])]
        up = high[joint] - here[joint] >= here[joint] - low[joint]
        for share in (1.0, 0.7, 0.5, _LEAST_STEP):
            for sign in (1.0, -1.0) if up else (-1.0, 1.0):
                room = high[joint] - here[joint] if sign > 0 else here[joint] - low[joint]
                size = min(full, room)
                if size < _LEAST_STEP * min(full, 0.5 * float(high[joint] - low[joint])):
                    continue
                goal = here.copy()
                goal[joint] += sign * share * size
                piece = transfer(here, goal, self.limits)
                if self._is_path_free(piece):
                    return self._gentle(piece)
        return None

    def _gentle(self, piece: JointTrajectory) -> JointTrajectory:
        """A move, as slow as readings need that stay within the range of the accelerometers."""
        if self.model is None:
            return piece
        q, none = piece.position, np.zeros_like(piece.position)
        up = np.array([0.0, 0.0, GRAVITY])
        f = specific_forces(self.model, q, piece.velocity, piece.acceleration, up)
        still = specific_forces(self.model, q, none, none, up)
        # What moves k times as slowly accelerates by k^2 times less.
        share = _within(f, still, _FULL * self.settings.full_scale)
        return slowed(piece, share**-0.5) if share < 1 else piece

    def _share_out(self, candidates: F64, taken: float, least: float) -> tuple[int, float]:
        """Number of poses, and the length of each one's pattern [s]."""
        pairs = candidates[: 2 * min(10, len(candidates) // 2)].reshape(-1, 2, candidates.shape[1])
        between = float(np.mean([transfer(a, b, self.limits).duration for a, b in pairs]))
        beside = self.settings.rest + self.settings.settle + between
        left = 60 * self.settings.minutes - taken
        count = int(left / (least + beside))
        if count < self.fewest:
            needed = (taken + self.fewest * (least + beside)) / 60
            raise PlanError(
                f"{self.settings.minutes:g} minutes are too short: moves of single joints take "
                f"{taken:.0f} s, and each of at least {self.fewest} poses {least + beside:.0f} s, "
                f"{least:.1f} of them for the pattern of {self.limits.n_joints} joints",
                f"ask for --minutes {np.ceil(10 * needed + 1) / 10:.1f} or more, lock joints, or "
                "allow more speed",
                minutes=needed,
            )
        count = min(count, _MOST)
        return count, left / count - beside

    def _amplitudes(self, poses: F64, length: float) -> F64:
        """(C, D) acceleration of each tone in each pose, with signs drawn at random."""
        signs = self.rng.choice([-1.0, 1.0], poses.shape)
        budget = _FULL * self.settings.full_scale - GRAVITY
        ramp = self.settings.ramp
        time = np.arange(0.0, length, 0.04)
        q, qd, qdd = waveform(self.tones, time, length, ramp)
        peak = np.abs(qdd).max(axis=0)
        if self.model is None:
            # All at once, accelerations add up like the root of their number.
            share = budget / np.sqrt(self.limits.n_joints) / _UNKNOWN_REACH
            return np.asarray(np.minimum(self.largest, share / peak) * signs)
        up = np.array([0.0, 0.0, GRAVITY])
        D = self.limits.n_joints
        out = np.empty_like(poses)
        for c, pose in enumerate(poses):
            arms = np.linalg.norm(first_order(self.model, pose, up)[1 + D :], axis=2)
            reach = arms.max(axis=1)
            alone = np.minimum(self.largest, budget / np.maximum(reach * peak, 1e-9)) * signs[c]
            f = specific_forces(self.model, pose + q * alone, qd * alone, qdd * alone, up)
            out[c] = alone * _within(f, f[0], _FULL * self.settings.full_scale)
        return out

    def _best(
        self, roadmap: Roadmap, nodes: F64, amplitude: F64, count: int, length: float
    ) -> list[int]:
        """Indices of the poses that tell most, among those that can be reached."""
        chosen: list[int] = []
        known: Known | None = None
        if self.model is not None:
            before = self.earlier.information if self.earlier else (None, None)
            _, state, known = known_before(self.model, *before)
        for share in _SHARES:
            scaled_by = np.where(np.isin(np.arange(len(nodes)), chosen), 1.0, share)[:, None]
            accept = self._accept(roadmap, nodes, scaled_by * amplitude, length, chosen)
            left = count - len(chosen)
            if known is None or self.model is None:
                span = np.maximum(np.ptp(nodes, axis=0), 1e-9)
                more = spread_out(nodes, left, accept, span, chosen)
            else:
                told = pattern_information(
                    self.model, state, nodes, self.tones, scaled_by * amplitude, length,
                    self.settings.ramp, self.rng,
                )  # fmt: skip
                criterion: Criterion = "trace" if self.earlier else "determinant"
                exchanges = 0 if self.limits.n_joints >= _MANY else 2
                more = choose(known, told, left, criterion, accept, exchanges)
                for c in more:
                    known = known.plus(told, c)
            amplitude[more] *= share
            chosen += more
            if len(chosen) >= count or self.checker is None:
                break
        if len(chosen) < self.fewest:
            raise PlanError(
                f"only {len(chosen)} of {len(nodes)} poses have room for a pattern, and a way "
                "there, without anything touching",
                f"check the shapes in the URDF's <collision>{self._crowded}, name links that may "
                "touch (--srdf), or plan without shapes (--no-collisions)",
            )
        return chosen

    def _accept(
        self, roadmap: Roadmap, nodes: F64, amplitude: F64, length: float, taken: list[int]
    ) -> Callable[[int], bool]:
        """Whether a pose is not taken yet, can be reached, and has room for its pattern."""

        @cache
        def accept(c: int) -> bool:
            if c in taken:
                return False
            piece = self._pattern(nodes[c], amplitude[c], length)
            return self._is_path_free(piece) and roadmap.way(_START, c) is not None

        return accept

    def _pattern(self, pose: F64, amplitude: F64, length: float) -> JointTrajectory:
        """A pattern within the limits, whose peaks depend a little on its length."""
        ramp = self.settings.ramp
        piece = pattern(pose, self.tones, amplitude, length, ramp, self.limits)
        over = float(strain(piece, self.limits)[1:].max())
        if over <= 1.0:
            return piece
        return pattern(pose, self.tones, _ROOM / over * amplitude, length, ramp, self.limits)

    def _assembled(
        self,
        moves: list[Move],
        poses: F64,
        amplitude: F64,
        ways: list[list[JointTrajectory]],
        least: float,
    ) -> Plan:
        """The whole motion, as long as it was asked for."""
        beside = self.settings.rest + self.settings.settle
        taken = sum(piece.duration for _, piece in moves)
        total = 60 * self.settings.minutes
        while True:
            between = sum(piece.duration for way in ways for piece in way)
            length = (total - taken - between) / len(ways) - beside
            if length >= least or len(ways) <= self.fewest:
                break
            ways = ways[:-1]
        if length < self.tones.apart:
            needed = (taken + between + len(ways) * (least + beside)) / 60
            raise PlanError(
                f"{self.settings.minutes:g} minutes are too short for {len(ways)} poses and the "
                "transfers between them",
                f"ask for --minutes {np.ceil(10 * needed + 1) / 10:.1f} or more, or allow more "
                "speed",
                minutes=needed,
            )
        pieces = [piece for _, piece in moves]
        kinds: list[tuple[PhaseKind, int, int]] = [(kind, joint, -1) for (kind, joint), _ in moves]
        for p, (pose, way) in enumerate(zip(poses, ways, strict=False)):
            for piece in way:
                pieces.append(piece)
                kinds.append(("move", -1, -1))
            pieces.append(self._rest(pose, self.settings.rest))
            kinds.append(("rest", -1, p))
            pieces.append(self._free_pattern(pose, amplitude[p], length))
            kinds.append(("pattern", -1, p))
            pieces.append(self._rest(pose, self.settings.settle))
            kinds.append(("rest", -1, p))
        trajectory = joined(self.limits.joint_names, pieces)
        over = strain(trajectory, self.limits)
        if over.max() > 1.0 + 1e-9:
            raise RuntimeError(f"a plan leaves its limits by factors of {over}")
        ends = np.cumsum([piece.duration for piece in pieces])
        phases = tuple(
            Phase(kind, float(end - piece.duration), float(end), joint, pose)
            for (kind, joint, pose), piece, end in zip(kinds, pieces, ends, strict=True)
        )
        notes = (*self.given.notes, *(self.checker.notes if self.checker else ()), *self.notes)
        return Plan(
            trajectory, phases, poses[: len(ways)], self.given,
            self.checker.n_pairs if self.checker else None, tuple(notes),
        )  # fmt: skip

    def _free_pattern(self, pose: F64, amplitude: F64, length: float) -> JointTrajectory:
        """The pattern, smaller where something would touch; in the end none at all."""
        for share in (*_SHARES, 0.0):
            piece = self._pattern(pose, share * amplitude, length)
            if self._is_path_free(piece):
                return piece
        return piece

    def _visited(self, roadmap: Roadmap, chosen: list[int]) -> list[list[JointTrajectory]]:
        """Ways to all poses, each time to the one that is reached soonest; sorts these likewise."""
        left, here = list(chosen), _START
        chosen.clear()
        ways: list[list[JointTrajectory]] = []
        while left:
            nearest = min(left, key=lambda i: float(roadmap.length[here, i] or np.inf))
            left.remove(nearest)
            # All can be reached from the start, and so from each other.
            way = roadmap.way(here, nearest) or self._through_start(roadmap, here, nearest)
            if way is not None:
                chosen.append(nearest)
                ways.append([self._gentle(piece) for piece in way])
                here = nearest
        return ways

    def _through_start(
        self, roadmap: Roadmap, here: int, there: int
    ) -> list[JointTrajectory] | None:
        back, forth = roadmap.way(here, _START), roadmap.way(_START, there)
        return None if back is None or forth is None else [*back, *forth]


def _within(f: F64, still: F64, most: float) -> float:
    """By how much motion may be made larger, at most 1, so that readings stay within a range.

    Args:
        f: (N, U, 3) readings of the motion [m/s^2].
        still: (U, 3) readings at rest, or (N, U, 3) where these change on the way.
        most: range [m/s^2].
    """
    change = f - still
    a = (change**2).sum(axis=2)
    b = (change * still).sum(axis=2)
    c = (still**2).sum(axis=-1) - most**2
    root = (-b + np.sqrt(np.maximum(b**2 - a * c, 0.0))) / np.maximum(a, 1e-12)
    return float(min(1.0, root[a > 1e-9].min(initial=1.0)))
