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
from skin2urdf.estimation.trajectory.front_end import front_end, front_end_slopes
from skin2urdf.estimation.trajectory.gyro import predicted_turning, rate_columns, with_gyros
from skin2urdf.estimation.trajectory.kinematics import (
    FrameMotion,
    Path,
    frame_motions,
    joint_columns,
    own_columns,
    placed,
    placement_columns,
    seen_before_joint,
    seen_from_parent,
)
from skin2urdf.estimation.trajectory.points import SharedPoints, shared_points
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
from skin2urdf.model.records import KinematicModel
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
        resting = tree.su_joint < 0
        # On a base that gives way, an SU shows where it is.
        su[resting, :3] |= self.skeleton.tree is not tree
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
        felt = self._felt_by_points(state, log, g)
        lags, shares = self.lags(state, g), self.knot_shares(g)
        at = log.kept[:, None] + log.rate * lags
        residual = np.empty((len(log.kept), self.tree.n_sus, 3))
        matrices = places.sensor_matrix()
        within, rate, margin = _compared(log)
        for link in self.points(state):
            for some in link.parts():
                read = some.read(matrices[some.sus], felt[:, :3])
                read = front_end(read, state.front[some.sus], rate, margin)[..., within]
                for u, mine in zip(some.sus, read, strict=True):
                    bias = places.bias[u] + shares @ state.knots[g][:, u]
                    residual[:, u] = taken_at(log.readings[:, u], at[:, u]) - mine.T - bias
        measured = log.valid & np.isfinite(residual).all(axis=2)
        links = self.skeleton.numbers
        turned = predicted_turning(
            self.skeleton.model(places.T_parent_joint, places.T_joint_su),
            log, (log.q[:, links], log.qd[:, links]), state, g, lags,
        )  # fmt: skip
        return Predicted(residual, measured, felt, turned=turned)

    def points(self, state: MotionState) -> tuple[SharedPoints, ...]:
        """The links of the tree with hinges that carry SUs, and the points that stand for them."""
        T = self.skeleton.su_placements(state.placements.T_joint_su)
        return shared_points(self.skeleton.tree.su_joint, T)

    def _felt_by_points(self, state: MotionState, log: Trajectory, g: int) -> F64:
        """(P, 6, M) specific force at all points and its derivative, M from end to end of a log."""
        places, tree, links = state.placements, self.skeleton.tree, self.points(state)
        T = np.tile(np.eye(4), (links[-1].at.stop, 1, 1))
        for link in links:
            T[link.at, :3, 3] = link.arms
        carried_by = np.repeat([link.joint for link in links], [len(link.arms) for link in links])
        tree = replace(tree, su_names=tuple(map(str, range(len(T)))), su_joint=carried_by)
        model = KinematicModel(tree, self.skeleton.placements(places.T_parent_joint), T)
        q, qd, qdd = (x[:, self.skeleton.numbers] for x in (log.q, log.qd, log.qdd))
        force = specific_forces(model, q, qd, qdd, places.up[g] * state.gravity)
        force = filtered(force * sense(self.priors, state), log.taps)
        both = np.concatenate([force, first_derivative(force, log.rate)], axis=2)
        # Low-passed, nothing is lost at the rate of the samples that are compared.
        coarse = both[int(log.kept[0]) % log.every :: log.every]
        return np.ascontiguousarray(np.moveaxis(coarse, 0, 2))

    def ideal(self, state: MotionState, g: int, predicted: Predicted) -> Iterator[tuple[int, F64]]:
        """What perfect sensors in the SUs' places would read, SU by SU: (3, K) [m/s^2]."""
        within, _, _ = _compared(self.logs[g])
        perfect = np.broadcast_to(np.eye(3), (self.tree.n_sus, 3, 3))
        felt = predicted.felt[:, :3, within]
        for link in self.points(state):
            for some in link.parts():
                yield from zip(some.sus, some.read(perfect[some.sus], felt), strict=True)

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
        H, b = prior[:, at, at].copy(), gradient[:, at].copy()
        for g, (p, w) in enumerate(zip(predicted, weights, strict=True)):
            for u, ideal in self.ideal(state, g, p):
                root = np.sqrt(w[:, u, :3].T)
                A = (sensor_columns(ideal) * root).reshape(len(b[u]), -1)
                r = np.where(p.measured[:, u], p.residual[:, u].T, 0.0) * root
                H[u] += A @ A.T
                b[u] += A @ r.ravel()
        H = np.where(free[:, :, None] & free[:, None], H, 0.0) + np.eye(H.shape[1]) * ~free[:, None]
        x = np.linalg.solve(H, np.where(free, b, 0.0)[..., None])[..., 0]
        places = replace(
            state.placements,
            bias=state.placements.bias + x[:, :3],
            shape=state.placements.shape + x[:, 3:],
        )
        moved = []
        for g, p in enumerate(predicted):
            residual = np.array(p.residual)
            for u, ideal in self.ideal(state, g, p):
                residual[:, u] -= np.tensordot(sensor_columns(ideal), x[u], (0, 0)).T
            moved.append(replace(p, residual=residual))
        return replace(state, placements=places), tuple(moved)

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
            p, matrices = predicted[g], state.placements.sensor_matrix()
            for link in self.points(state):
                columns = self._joint_columns(int(link.sus[0]), g)
                of_points = self._columns_of_points(state, g, link, frames, motion)
                for some in link.parts():
                    # A reading is that of a perfect sensor times its sensitivity.
                    weight = some.sensed(matrices[some.sus] * sense(self.priors, state))
                    rates = self._rates(state, g, some, p)
                    for u, mine, rate in zip(some.sus, weight, rates, strict=True):
                        root = np.sqrt(weights[g][:, u, :3].T)
                        residual = np.where(p.measured[:, u], p.residual[:, u].T, 0.0)
                        A = np.empty((len(columns) + self.layout.n_su, 3, residual.shape[1]))
                        by_joints = (mine @ of_points).reshape(3, len(columns), -1)
                        np.multiply(by_joints.swapaxes(0, 1), root, out=A[: len(columns)])
                        here = placed(frames[1][link.joint], self._su_placement(state, u))
                        own = self._own_columns(state, g, u, here, rate)
                        np.multiply(own, root, out=A[len(columns) :])
                        yield g, int(u), columns, A, residual * root
                        if p.turned is None or not self.gyros[u]:
                            continue
                        A = self._gyro_columns(state, g, int(u), frames, p.turned)
                        root = np.sqrt(weights[g][:, u, 3:].T)
                        yield g, int(u), columns, A * root, p.turned.residual[:, u].T * root

    def _rates(self, state: MotionState, g: int, some: SharedPoints, predicted: Predicted) -> F64:
        """(S, 3, 3, K) derivatives of the readings of some SUs in time and in their front ends."""
        if predicted.rates is not None:
            return predicted.rates[:, :, some.sus].transpose(2, 0, 3, 1)
        within, rate, margin = _compared(self.logs[g])
        matrices, front = state.placements.sensor_matrix()[some.sus], state.front[some.sus]
        read, slope = (some.read(matrices, x) for x in np.split(predicted.felt, 2, axis=1))
        in_time = front_end(slope, front, rate, margin)
        by_front = front_end_slopes(read, front, rate, margin)
        return np.concatenate([in_time[None], by_front])[..., within].swapaxes(0, 1)

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

    def _columns_of_points(
        self,
        state: MotionState,
        g: int,
        link: SharedPoints,
        frames: tuple[list[FrameMotion], list[FrameMotion]],
        motion: tuple[F64, F64, F64],
    ) -> F64:
        """(3 p, C K) derivatives of what a link's points feel in the joint part, in its frame."""
        u, (fixed, carried) = int(link.sus[0]), frames
        pull = np.einsum(
            "ijk,j->ik", carried[link.joint].R_frame_base, state.placements.up[g] * state.gravity
        )
        C, K = len(self._joint_columns(u, g)), pull.shape[1]
        out = np.empty((len(link.arms), 3, C, K))
        for i, arm in enumerate(link.arms):
            T = np.eye(4)
            T[:3, 3] = arm
            here = placed(carried[link.joint], T)
            before, behind = self._columns_of_path(state, g, u, fixed, motion, here.R_frame_base, T)
            # With gravity grow the accelerations that a reading stands for.
            rows = [*before, (pull - here.f)[None], *behind]
            np.concatenate(rows, out=out[i].swapaxes(0, 1))
        return out.reshape(-1, C * K)

    def _columns_of_path(
        self,
        state: MotionState,
        g: int,
        u: int,
        fixed: list[FrameMotion],
        motion: tuple[F64, F64, F64],
        R_link_base: F64,
        T: F64,
    ) -> tuple[list[F64], list[F64]]:
        """Derivatives (c, 3, K) of what is felt at T (4, 4) of an SU's link, in its frame.

        Returns:
            In the coordinates before the size of gravity, and in those behind it.
        """
        layout, places = self.layout, state.placements
        tree, numbers = self.skeleton.tree, self.skeleton.numbers
        q, qd, qdd = motion
        K = q.shape[1]
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
        if g > 0:
            turn = np.cross(np.eye(3)[:2], places.up[g]) * state.gravity
            rows.append(np.einsum("ijk,cj->cik", R_link_base, turn))
        behind: list[F64] = []
        if self.unseen:
            felt = self._moving(u)
            beyond = np.zeros((len(felt), 3, K))
            for k, columns in by_joint.items():
                of_joint = np.flatnonzero(self.unseen.joint == k)
                number = np.searchsorted(felt, self.unseen.number[of_joint])
                e = self._motions[g][:, of_joint]
                np.add.at(beyond, number, np.einsum("dck,dsk->sck", columns, e))
            behind.append(beyond)
        if known:
            if g == 0:
                turn = np.cross(turn_axes(places.up[0]).T, places.up[0]) * state.gravity
                behind.append(np.einsum("ijk,cj->cik", R_link_base, turn))
            behind += reversed(along_axis)
        return rows, behind

    def _su_placement(self, state: MotionState, u: int) -> F64:
        """(4, 4) placement of an SU on the tree with hinges."""
        return np.asarray(self.skeleton.su_placements(state.placements.T_joint_su)[u])

    def _own_columns(
        self, state: MotionState, g: int, u: int, here: FrameMotion, rates: F64
    ) -> F64:
        """(n, 3, K) derivatives of an SU's prediction in its own coordinates.

        Args:
            state: where.
            g: number of the log.
            u: the SU.
            here: its motion.
            rates: (3, 3, K) derivatives in time and in its front end.
        """
        layout, sensed = self.layout, sense(self.priors, state)
        out = np.zeros((layout.n_su, 3, here.f.shape[1]))
        matrix = state.placements.sensor_matrix()[u] * sensed
        out[:N_PLACEMENT] = matrix @ own_columns(here)
        out[N_PLACEMENT:N_SU] = sensor_columns(here.f * sensed)
        out[layout.front] = rates[1:]
        out[layout.clock(g)] = -rates[0], self._since_middle(g) * -rates[0]
        shares = self.knot_shares(g)
        knots = np.zeros((shares.shape[1], 3, *out.shape[1:]))
        for i in range(3):
            knots[:, i, i] = shares.T
        out[layout.knots(g)] = knots.reshape(-1, *out.shape[1:])
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
    """(9, 3, K) derivatives of an SU's readings in bias and shape.

    Args:
        ideal: (3, K) what a perfect sensor would read [m/s^2].
    """
    out = np.zeros((9, *ideal.shape))
    out[range(3), range(3)] = 1.0
    for i, (a, b) in enumerate(_SHAPE):
        out[3 + i, a] = ideal[b]
        out[3 + i, b] = ideal[a]
    return out


def _compared(log: Trajectory) -> tuple[slice, float, int]:
    """Of samples from end to end of a log at the rate of those that are compared: which these are.

    Returns:
        Where they are, their rate [Hz], and for how many of them the low-pass is felt.
    """
    first = int(log.kept[0]) // log.every
    margin = -(-len(log.taps) // log.every)
    return slice(first, first + len(log.kept)), log.rate / log.every, margin
