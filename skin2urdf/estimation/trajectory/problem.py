"""Residuals of all samples along the logs, and their normal equations in arrow form."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.estimation.problem.state import (
    JOINT_COORDINATES,
    N_JOINT,
    N_PLACEMENT,
    N_SU,
    identifiable,
)
from skin2urdf.estimation.trajectory.blueprint import ALONG_AXIS, further_columns, turn_axes
from skin2urdf.estimation.trajectory.front_end import front_end
from skin2urdf.estimation.trajectory.gyro import predicted_turning, rate_columns, with_gyros
from skin2urdf.estimation.trajectory.kinematics import (
    FrameMotion,
    Path,
    frame_motions,
    joint_columns,
    placed,
    placement_columns,
    seen_before_joint,
    seen_from_parent,
)
from skin2urdf.estimation.trajectory.priors import (
    MotionPriors,
    prior_chi2,
    prior_information,
    sense,
    with_priors,
)
from skin2urdf.estimation.trajectory.records import Equations, Predicted, Spans, Turned
from skin2urdf.estimation.trajectory.skeleton import N_HINGES, Skeleton
from skin2urdf.estimation.trajectory.state import N_GYRO, Layout, MotionState
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.model.specific_force import specific_forces
from skin2urdf.signals.filters import filtered, first_derivative, taken_at
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

_SHAPE = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


class MotionProblem:
    """Chi-squared of all samples of all logs.

    Args:
        tree: D joints and U SUs.
        logs: trajectories, with columns in the tree's order.
        priors: what is known before.
        n_knots: moments between which biases are linear in each log.
        unseen: what encoders do not see; of as many numbers as ``priors.unseen`` has.
    """

    def __init__(
        self,
        tree: KinematicTree,
        logs: Sequence[Trajectory],
        priors: MotionPriors,
        n_knots: Sequence[int] | None = None,
        unseen: Unseen | None = None,
    ) -> None:
        self.tree, self.logs, self.priors = tree, tuple(logs), priors
        self.unseen = unseen
        self.skeleton = Skeleton.of(tree, unseen.joint if unseen else ())
        self._motions = unseen.at_kept(self.logs) if unseen else ()
        self._seconds = tuple(float(log.time[-1] - log.time[0]) for log in self.logs)
        knots = tuple(n_knots or [0] * len(self.logs))
        self.gyros = with_gyros(tree, self.logs)
        self.layout = Layout(
            tree.n_joints,
            len(self.logs),
            knots,
            len(priors.unseen),
            any(log.rates is not None for log in self.logs),
            priors.blueprint.n_coordinates if priors.blueprint else 0,
        )
        self.free_joint, self.free_su = self._free()

    def again(
        self, *, logs: Sequence[Trajectory] | None = None, priors: MotionPriors | None = None
    ) -> MotionProblem:
        """The same problem with other logs, or with something else known before."""
        return MotionProblem(
            self.tree,
            self.logs if logs is None else logs,
            priors or self.priors,
            self.layout.n_knots,
            self.unseen,
        )

    def coarse(self, *, unseen: bool = False) -> tuple[Bool, Bool]:
        """Coordinates (J,) and (U, n) to begin with: placements, biases and lags.

        From far away, a sensor's shape, droop and drift would rather explain what placements do.

        Args:
            unseen: whether what encoders do not see is to be found from the beginning as well.
        """
        layout, su = self.layout, np.zeros_like(self.free_su)
        joint = self.free_joint & (np.arange(layout.n_joint) < layout.gravity)
        joint[layout.further] = self.free_joint[layout.further]
        if unseen:
            joint[layout.unseen] = self.free_joint[layout.unseen]
        su[:, : N_PLACEMENT + 3] = True
        for g in range(layout.n_logs):
            su[:, layout.clock(g).start] = True
        if layout.gyros:
            su[:, layout.gyro.start + N_GYRO : layout.gyro.stop] = True
        return joint, su & self.free_su

    def _free(self) -> tuple[Bool, Bool]:
        layout, tree, priors = self.layout, self.tree, self.priors
        placements = identifiable(tree, len(self.logs), True)
        joint = np.ones(layout.n_joint, dtype=bool)
        joint[layout.joints] = placements.joints.ravel()
        if priors.blueprint:
            joint[layout.joints], joint[layout.further] = priors.blueprint.free()
        joint[layout.gravity] = priors.gravity > 0
        joint[layout.unseen] = priors.unseen > 0
        su = np.ones((tree.n_sus, layout.n_su), dtype=bool)
        su[:, :N_SU] = placements.sus
        su[:, N_PLACEMENT:N_SU] &= priors.sensors.deviations > 0
        su[:, layout.front] = priors.front[1] > 0
        # On a base that gives way, an SU shows where it is, and when it reads and how.
        resting = (tree.su_joint < 0) & (self.skeleton.tree is tree)
        if self.skeleton.tree is not tree:
            su[:, :3] = True
        for g in range(layout.n_logs):
            su[:, layout.clock(g)] = np.array([priors.lag > 0, priors.drift > 0])
            su[resting, layout.clock(g)] = False
            su[:, layout.knots(g)] = priors.bias_walk > 0
        su[resting, layout.front] = False
        su[~np.any([log.valid.any(axis=0) for log in self.logs], axis=0)] = False
        if layout.gyros:
            of_log = np.tile(priors.gyro[N_GYRO:], layout.n_logs)
            known = np.concatenate([priors.gyro[:N_GYRO], of_log])
            su[:, layout.gyro] = self.gyros[:, None] & (known > 0)
        return joint, su

    def knot_shares(self, g: int) -> F64:
        """(K, B) how much each knot counts at the kept samples of a log; linear in between."""
        n, time = self.layout.n_knots[g], self.logs[g].time
        if not n:
            return np.zeros((len(time), 0))
        at = (time - time[0]) / (time[-1] - time[0]) * (n - 1)
        return np.asarray(np.maximum(0.0, 1 - np.abs(at[:, None] - np.arange(n))))

    def predict(self, state: MotionState, g: int) -> Predicted:
        """Residuals of one log."""
        log, places = self.moved(state, g), state.placements
        model = self.skeleton.model(places.T_parent_joint, places.T_joint_su)
        q, qd, qdd = (x[:, self.skeleton.numbers] for x in (log.q, log.qd, log.qdd))
        ideal = specific_forces(model, q, qd, qdd, places.up[g] * state.gravity)
        ideal = filtered(ideal * sense(self.priors, state), log.taps)
        read = (ideal.swapaxes(0, 1) @ state.placements.sensor_matrix()).swapaxes(0, 1)
        read, by_front = front_end(read, state.front, log.rate, len(log.taps))
        rates = np.stack([first_derivative(read, log.rate), *by_front])[:, log.kept]
        predicted = read[log.kept] + state.placements.bias
        predicted += np.einsum("kb,bui->kui", self.knot_shares(g), state.knots[g])
        at = log.kept[:, None] + log.rate * self.lags(state, g)
        residual = np.empty_like(predicted)
        for u in range(self.tree.n_sus):
            residual[:, u] = taken_at(log.readings[:, u], at[:, u]) - predicted[:, u]
        measured = log.valid & np.isfinite(residual).all(axis=2)
        turned = predicted_turning(model, log, (q, qd), state, g, self.lags(state, g))
        return Predicted(residual, measured, ideal[log.kept], rates, turned)

    def moved(self, state: MotionState, g: int) -> Trajectory:
        """A log with the motion of the links, of which encoders do not see all."""
        log = self.logs[g]
        return self.unseen.moved(log, g, state.unseen) if self.unseen else log

    def bent(self, state: MotionState) -> tuple[F64, ...]:
        """Per log (K, D + 6) what is beyond encoders of joints, and of the base [rad or m]."""
        return tuple(
            np.hstack(both)
            for both in zip(self.deflections(state), self.base_motions(state), strict=True)
        )

    def deflections(self, state: MotionState) -> tuple[F64, ...]:
        """Per log (K, D) by how much links are beyond what encoders say [rad or m]."""
        n = self.tree.n_joints
        return tuple(
            (self.moved(state, g).q[:, :n] - log.q)[log.kept] for g, log in enumerate(self.logs)
        )

    def base_motions(self, state: MotionState) -> tuple[F64, ...]:
        """Per log (K, 6) shifts along and turns about the axes of the base [m, rad]."""
        n = self.tree.n_joints
        still = self.skeleton.tree is self.tree
        return tuple(
            np.zeros((len(log.kept), N_HINGES)) if still else self.moved(state, g).q[log.kept, n:]
            for g, log in enumerate(self.logs)
        )

    def refit_sensors(
        self,
        state: MotionState,
        predicted: Sequence[Predicted],
        weights: Sequence[F64],
        free_su: Bool,
    ) -> tuple[MotionState, tuple[Predicted, ...]]:
        """The best bias and shape of every SU for its placement, a linear problem.

        Where gravity stands still in an SU, its tilt and its bias can hardly be told apart. The
        pairs that explain the readings form an arc, which a step in both leaves; this leads back.

        Args:
            state: placements, and sensors to begin with.
            predicted: residuals of each log there.
            weights: per log (K, U, 3) information of each sample [s^4/m^2]; gyroscopes' behind it.
            free_su: (U, n) coordinates that may move.
        """
        at = slice(N_PLACEMENT, N_SU)
        free = free_su[:, at]
        _, prior, _, gradient = self.prior_information(state)
        H, g = prior[:, at, at].copy(), gradient[:, at].copy()
        columns = [sensor_columns(p.ideal) for p in predicted]
        for A, p, w in zip(columns, predicted, weights, strict=True):
            w, r = w[..., :3], np.where(p.measured[..., None], p.residual, 0.0)
            H += np.einsum("kucx,kux,kudx->ucd", A, w, A, optimize=True)
            g += np.einsum("kucx,kux->uc", A, w * r)
        H = np.where(free[:, :, None] & free[:, None], H, 0.0) + np.eye(H.shape[1]) * ~free[:, None]
        x = np.linalg.solve(H, np.where(free, g, 0.0)[..., None])[..., 0]
        places = replace(
            state.placements,
            bias=state.placements.bias + x[:, :3],
            shape=state.placements.shape + x[:, 3:],
        )
        moved = tuple(
            replace(p, residual=p.residual - np.einsum("kucx,uc->kux", A, x))
            for A, p in zip(columns, predicted, strict=True)
        )
        return replace(state, placements=places), moved

    def lags(self, state: MotionState, g: int) -> F64:
        """(K, U) by how much the readings of a log are late [s]."""
        lag, drift = state.clock[g].T
        return np.asarray(lag + drift * self._since_middle(g)[:, None])

    def _since_middle(self, g: int) -> F64:
        """(K,) times since the middle of a log [s]."""
        time = self.logs[g].time
        return np.asarray(time - 0.5 * (time[0] + time[-1]))

    def equations(
        self, state: MotionState, predicted: Sequence[Predicted], weights: Sequence[F64]
    ) -> Equations:
        """Normal equations at a state, priors included.

        Args:
            state: where.
            predicted: residuals of each log there.
            weights: per log (K, U, 3) information of each sample [s^4/m^2], 0 leaves one out;
                (K, U, 6) with that of gyroscopes [s^2/rad^2] where a log has any.
        """
        layout, U = self.layout, self.tree.n_sus
        J, n = layout.n_joint, layout.n_su
        joint, su, mixed = np.zeros((J, J)), np.zeros((U, n, n)), np.zeros((U, n, J))
        joint_gradient, su_gradient = np.zeros(J), np.zeros((U, n))
        for _, u, columns, A, r in self._rows(state, predicted, weights):
            nj, flat = len(columns), A.reshape(len(A), -1)
            H, gradient = flat @ flat.T, flat @ r.ravel()
            joint[np.ix_(columns, columns)] += H[:nj, :nj]
            su[u] += H[nj:, nj:]
            mixed[u][:, columns] += H[nj:, :nj]
            joint_gradient[columns] += gradient[:nj]
            su_gradient[u] += gradient[nj:]
        data = Equations(joint, su, mixed, joint_gradient, su_gradient)
        return with_priors(self.priors, self.layout, self._seconds, state, data)

    def spans(
        self,
        state: MotionState,
        predicted: Sequence[Predicted],
        weights: Sequence[F64],
        n_spans: int,
        n_draws: int,
        rng: np.random.Generator,
    ) -> Spans:
        """Contributions of spans of time to the normal equations without priors.

        Args:
            state: where.
            predicted: residuals of each log there.
            weights: per log (K, U, 3) information of each sample [s^4/m^2].
            n_spans: spans per log, of equal length.
            n_draws: versions of the gradients with independent noise.
            rng: source of that noise.
        """
        layout, U, G = self.layout, self.tree.n_sus, len(self.logs)
        J, n, S = layout.n_joint, layout.n_su, G * n_spans
        of_all = [
            sorted({c for g in range(G) for c in self._joint_columns(u, g)}) for u in range(U)
        ]
        width = max(map(len, of_all))
        columns = np.full((U, width), -1)
        joint, su = np.zeros((S, J, J)), np.zeros((S, U, n, n))
        mixed = np.zeros((S, U, n, width))
        joint_scores = np.zeros((1 + n_draws, S, J))
        su_scores = np.zeros((1 + n_draws, S, U, n))
        for u in range(U):
            columns[u, : len(of_all[u])] = of_all[u]
        for g, u, own, A, r in self._rows(state, predicted, weights):
            nj, K = len(own), r.shape[1]
            place = np.searchsorted(columns[u][columns[u] >= 0], own)
            noise = rng.standard_normal((n_draws, 3, K))
            both = np.concatenate([r[None], noise])
            edges = np.linspace(0, K, n_spans + 1).astype(int)
            for i, (first, last) in enumerate(pairwise(edges)):
                s = g * n_spans + i
                part = A[:, :, first:last].reshape(len(A), -1)
                H = part @ part.T
                scores = both[:, :, first:last].reshape(len(both), -1) @ part.T
                joint[s][np.ix_(own, own)] += H[:nj, :nj]
                su[s, u] += H[nj:, nj:]
                mixed[s, u][:, place] += H[nj:, :nj]
                joint_scores[:, s, own] += scores[:, :nj]
                su_scores[:, s, u] += scores[:, nj:]
        return Spans(joint, su, mixed, columns, joint_scores, su_scores)

    def pulls_of_joints(
        self, state: MotionState, predicted: Sequence[Predicted], weights: Sequence[F64]
    ) -> list[tuple[F64, F64]]:
        """What residuals say of motion that encoders do not see, moment by moment.

        Args:
            state: where.
            predicted: residuals of each log there.
            weights: per log (K, U, 3) information of each sample [s^4/m^2].

        Returns:
            Per log (D, 3, K) gradient in a joint's position, velocity and acceleration beyond its
            encoder, and (D, 3, 3, K) information on them, all else as it is.
        """
        out = []
        sensors, T = state.placements.sensor_matrix(), state.placements.T_joint_su
        for g in range(len(self.logs)):
            motion, (fixed, _) = self._frames(state, g)
            K = motion[0].shape[1]
            first = len(self.skeleton.hinges)
            G, H = np.zeros((self.tree.n_joints, 3, K)), np.zeros((self.tree.n_joints, 3, 3, K))
            for u in range(self.tree.n_sus):
                root = np.sqrt(weights[g][:, u, :3].T)
                p = predicted[g]
                r = np.where(p.measured[:, u], p.residual[:, u].T, 0.0) * root
                path = _fixed_path(T[u], K)
                for k in reversed(self.tree.chain(int(self.tree.su_joint[u]))):
                    slides = bool(self.tree.prismatic[k])
                    path = seen_before_joint(path, slides, *(x[first + k] for x in motion))
                    c = joint_columns(fixed[first + k], path, slides)
                    c = np.einsum("ij,djk->dik", sensors[u], c) * root
                    G[k] += np.einsum("dik,ik->dk", c, r)
                    H[k] += np.einsum("dik,eik->dek", c, c)
                    path = seen_from_parent(path, state.placements.T_parent_joint[k])
            out.append((G, H))
        return out

    def _frames(
        self, state: MotionState, g: int
    ) -> tuple[tuple[F64, F64, F64], tuple[list[FrameMotion], list[FrameMotion]]]:
        """Motion (H + D, K) of hinges and joints at the samples compared, and of their frames."""
        log, skeleton = self.moved(state, g), self.skeleton
        at = np.ix_(log.kept, skeleton.numbers)
        q, qd, qdd = (np.ascontiguousarray(x[at].T) for x in (log.q, log.qd, log.qdd))
        up = state.placements.up[g] * state.gravity
        T = skeleton.placements(state.placements.T_parent_joint)
        return (q, qd, qdd), frame_motions(skeleton.tree, T, up, q, qd, qdd)

    def _rows(
        self, state: MotionState, predicted: Sequence[Predicted], weights: Sequence[F64]
    ) -> Iterator[tuple[int, int, list[int], F64, F64]]:
        """Whitened derivatives (C + n, 3, K) and residuals (3, K) of every log and SU."""
        for g in range(len(self.logs)):
            motion, frames = self._frames(state, g)
            for u in range(self.tree.n_sus):
                A = self._columns(state, g, u, frames, motion, predicted[g].rates[:, :, u])
                root = np.sqrt(weights[g][:, u, :3].T)
                residual = np.where(predicted[g].measured[:, u], predicted[g].residual[:, u].T, 0.0)
                yield g, u, self._joint_columns(u, g), A * root, residual * root
                turned = predicted[g].turned
                if turned is None or not self.gyros[u]:
                    continue
                A = self._gyro_columns(state, g, u, frames, turned)
                root = np.sqrt(weights[g][:, u, 3:].T)
                yield g, u, self._joint_columns(u, g), A * root, turned.residual[:, u].T * root

    def _joint_columns(self, u: int, g: int) -> list[int]:
        """Columns of the joint part that an SU's readings in a log depend on."""
        layout, chain = self.layout, self.tree.chain(int(self.tree.su_joint[u]))
        columns = [N_JOINT * k + i for k in chain for i in range(N_JOINT)]
        if g > 0:
            columns += range(layout.logs.start + 2 * (g - 1), layout.logs.start + 2 * g)
        columns.append(layout.gravity)
        if self.unseen:
            columns += list(layout.unseen.start + self._moving(u))
        if self.priors.blueprint:
            columns += further_columns(layout.further.start, chain, g)
        return columns

    def _moving(self, u: int) -> Int:
        """Which of the numbers that make unseen motion an SU feels."""
        if self.unseen is None:
            return np.zeros(0, dtype=np.int64)
        return np.unique(self.unseen.number[self._felt(self.unseen, u)])

    def _felt(self, unseen: Unseen, u: int) -> Bool:
        """(E,) entries of unseen motion that an SU feels."""
        carried_by = self.skeleton.numbers[list(self._chain(u))]
        return np.asarray(np.isin(unseen.joint, carried_by))

    def _chain(self, u: int) -> tuple[int, ...]:
        """What carries an SU, from the ground on: places in the tree with hinges."""
        return self.skeleton.tree.chain(int(self.skeleton.tree.su_joint[u]))

    def _gyro_columns(
        self,
        state: MotionState,
        g: int,
        u: int,
        frames: tuple[list[FrameMotion], list[FrameMotion]],
        turned: Turned,
    ) -> F64:
        """(C + n, 3, K) derivatives of what an SU's gyroscope is predicted to read."""
        fixed, carried = frames
        tree, numbers = self.skeleton.tree, self.skeleton.numbers
        T = self.skeleton.su_placements(state.placements.T_joint_su)[u]
        here = placed(carried[int(tree.su_joint[u])], T)
        none = np.zeros(0, dtype=np.int64)
        unseen = none, none, np.zeros((2, 0, here.w.shape[1]))
        if self.unseen:
            felt = self._felt(self.unseen, u)
            number = np.searchsorted(self._moving(u), self.unseen.number[felt])
            unseen = self.unseen.joint[felt], number, self._motions[g][:2, felt]
        slides = dict(zip(numbers.tolist(), tree.prismatic.tolist(), strict=True))
        of_number = dict(zip(numbers.tolist(), fixed, strict=True)), here
        slopes = turned.slope[:, u], turned.bend[:, u], self._since_middle(g)
        return rate_columns(self.tree, state, self.layout, g, u, of_number, slides, unseen, slopes)

    def _columns(
        self,
        state: MotionState,
        g: int,
        u: int,
        frames: tuple[list[FrameMotion], list[FrameMotion]],
        motion: tuple[F64, F64, F64],
        rates: F64,
    ) -> F64:
        """(C + n, 3, K) derivatives of an SU's prediction, joint columns first."""
        layout, places = self.layout, state.placements
        tree, numbers = self.skeleton.tree, self.skeleton.numbers
        q, qd, qdd = motion
        K = q.shape[1]
        fixed, carried = frames
        M, sensed = places.sensor_matrix()[u], sense(self.priors, state)
        T = self.skeleton.su_placements(places.T_joint_su)[u]
        here = placed(carried[int(tree.su_joint[u])], T)
        rows: list[F64] = []
        by_joint: dict[int, F64] = {}
        path = _fixed_path(T, K)
        # A known robot may also deviate along and about its axes.
        known = self.priors.blueprint is not None
        wanted = JOINT_COORDINATES + ALONG_AXIS if known else JOINT_COORDINATES
        along_axis: list[F64] = []
        placements = self.skeleton.placements(places.T_parent_joint)
        for j in reversed(self._chain(u)):
            slides = bool(tree.prismatic[j])
            path = seen_before_joint(path, slides, q[j], qd[j], qdd[j])
            if numbers[j] < layout.n_joints:
                columns = placement_columns(fixed[j], path, wanted)
                rows.append(columns[: len(JOINT_COORDINATES)])
                along_axis.append(columns[len(JOINT_COORDINATES) :])
            if self.unseen:
                by_joint[int(numbers[j])] = joint_columns(fixed[j], path, slides)
            path = seen_from_parent(path, placements[j])
        rows.reverse()
        R_su_base = here.R_frame_base
        if g > 0:
            turn = np.cross(np.eye(3)[:2], places.up[g]) * state.gravity
            rows.append(np.einsum("ijk,cj->cik", R_su_base, turn))
        pull = np.einsum("ijk,j->ik", R_su_base, places.up[g] * state.gravity)
        # With gravity grow the accelerations that a reading stands for.
        rows.append((pull - here.f)[None])
        if self.unseen:
            felt = self._moving(u)
            beyond = np.zeros((len(felt), 3, K))
            for k, columns in by_joint.items():
                of_joint = np.flatnonzero(self.unseen.joint == k)
                number = np.searchsorted(felt, self.unseen.number[of_joint])
                e = self._motions[g][:, of_joint]
                np.add.at(beyond, number, np.einsum("dck,dsk->sck", columns, e))
            rows.append(beyond)
        if known:
            if g == 0:
                turn = np.cross(turn_axes(places.up[0]).T, places.up[0]) * state.gravity
                rows.append(np.einsum("ijk,cj->cik", R_su_base, turn))
            rows += reversed(along_axis)
        rows.append(placement_columns(here, _fixed_path(np.eye(4), K), tuple(range(N_PLACEMENT))))
        ideal = np.concatenate(rows)
        C = len(ideal) - N_PLACEMENT
        out = np.zeros((C + layout.n_su, 3, K))
        out[: C + N_PLACEMENT] = np.einsum("ij,cjk->cik", M * sensed, ideal)
        own = out[C:]
        own[N_PLACEMENT:N_SU] = sensor_columns(here.f.T[:, None] * sensed)[:, 0].transpose(1, 2, 0)
        own[layout.front] = rates[1:].swapaxes(1, 2)
        late = -rates[0].T
        own[layout.clock(g)] = late, self._since_middle(g) * late
        shares = self.knot_shares(g)
        knots = np.zeros((shares.shape[1], 3, 3, K))
        for i in range(3):
            knots[:, i, i] = shares.T
        own[layout.knots(g)] = knots.reshape(-1, 3, K)
        return out

    def prior_information(self, state: MotionState) -> tuple[F64, F64, F64, F64]:
        """Information (J,) and (U, n, n) of the priors and their gradients (J,) and (U, n)."""
        return prior_information(self.priors, self.layout, self._seconds, state)

    def prior_chi2(self, state: MotionState) -> float:
        """Chi-squared of the priors at a state."""
        return prior_chi2(self.priors, self.layout, self._seconds, state)


def _fixed_path(T: F64, n: int) -> Path:
    """Path of n samples of an SU that is fixed to a frame by T (4, 4)."""
    still = np.zeros((3, n))
    return Path(still + T[:3, 3:4], still, still, np.repeat(T[:3, :3, None], n, axis=2))


def sensor_columns(ideal: F64) -> F64:
    """(K, U, 9, 3) derivatives of readings in bias and shape.

    Args:
        ideal: (K, U, 3) what perfect sensors would read [m/s^2].
    """
    out = np.zeros((*ideal.shape[:2], 9, 3))
    out[..., range(3), range(3)] = 1.0
    for i, (a, b) in enumerate(_SHAPE):
        out[..., 3 + i, a] = ideal[..., b]
        out[..., 3 + i, b] = ideal[..., a]
    return out
