"""Residuals of all samples along the logs, and their normal equations in arrow form."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from skin2urdf.arrays import F64, Bool, Int, frozen
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import (
    JOINT_COORDINATES,
    N_JOINT,
    N_PLACEMENT,
    N_SU,
    identifiable,
)
from skin2urdf.estimation.trajectory.elastic import Elasticity
from skin2urdf.estimation.trajectory.front_end import front_end
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
from skin2urdf.estimation.trajectory.state import (
    Layout,
    MotionState,
)
from skin2urdf.model.specific_force import specific_forces
from skin2urdf.signals.filters import filtered, first_derivative, taken_at
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

_SHAPE = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


@dataclass(frozen=True)
class MotionPriors:
    """What is known before the logs are read, as standard deviations; 0 fixes a quantity.

    Attributes:
        sensors: bias, scale, cross-axis and offsets, as for features.
        gravity: of the magnitude of gravity [m/s^2].
        front: (2, 2) mean and standard deviation of a sensor's front end [s^2].
        lag: of an SU's clock [s].
        drift: of its rate [1].
        bias_walk: of the change of a bias per root of a second [m/s^2/sqrt(s)].
        compliance: (S,) of what the joints yield, in units of the regressors.
    """

    sensors: Priors
    gravity: float
    front: F64
    lag: float
    drift: float
    bias_walk: float
    compliance: F64

    def __post_init__(self) -> None:
        for name in ("front", "compliance"):
            object.__setattr__(self, name, frozen(getattr(self, name)))


@dataclass(frozen=True, eq=False)
class Predicted:
    """One log held against a state.

    Attributes:
        residual: (K, U, 3) readings less prediction [m/s^2].
        measured: (K, U) where there is something to compare.
        ideal: (K, U, 3) what perfect sensors in the SUs' places would read, as predicted [m/s^2].
        rates: (3, K, U, 3) derivatives of predicted readings in time, and in the coordinates of the
            sensors' front ends.
    """

    residual: F64
    measured: Bool
    ideal: F64
    rates: F64


@dataclass(frozen=True, eq=False)
class Equations:
    """Normal equations in arrow form: a joint part, and one part per SU.

    Attributes:
        joint: (J, J), and
        su: (U, n, n), and
        mixed: (U, n, J) information.
        joint_gradient: (J,), and
        su_gradient: (U, n): half the slope of chi-squared, with its sign turned.
    """

    joint: F64
    su: F64
    mixed: F64
    joint_gradient: F64
    su_gradient: F64


@dataclass(frozen=True, eq=False)
class Spans:
    """Contributions of S spans of time to the normal equations and to their gradients.

    Gradients come in several versions: with the residuals as they are, and with independent noise
    of unit size in place of the whitened residuals, drawn anew in each version.

    Attributes:
        joint: (S, J, J), and
        su: (S, U, n, n), and
        mixed: (S, U, n, C) information, in the joint columns that an SU depends on.
        columns: per SU (C,) these columns, padded with -1.
        joint_scores: (V, S, J) gradients of V versions, the first that of the residuals.
        su_scores: (V, S, U, n).
    """

    joint: F64
    su: F64
    mixed: F64
    columns: Int
    joint_scores: F64
    su_scores: F64


class MotionProblem:
    """Chi-squared of all samples of all logs.

    Args:
        tree: D joints and U SUs.
        logs: trajectories, with columns in the tree's order.
        priors: what is known before.
        n_knots: moments between which biases are linear in each log.
        elastic: how joints may yield; those of as many numbers as ``priors.compliance`` has.
    """

    def __init__(
        self,
        tree: KinematicTree,
        logs: Sequence[Trajectory],
        priors: MotionPriors,
        n_knots: Sequence[int] | None = None,
        elastic: Elasticity | None = None,
    ) -> None:
        self.tree, self.logs, self.priors = tree, tuple(logs), priors
        self.elastic = elastic
        self._deflections = elastic.at_kept(self.logs) if elastic else ()
        knots = tuple(n_knots or [0] * len(self.logs))
        self.layout = Layout(tree.n_joints, len(self.logs), knots, len(priors.compliance))
        self.free_joint, self.free_su = self._free()

    def coarse(self) -> tuple[Bool, Bool]:
        """Coordinates (J,) and (U, n) to begin with: placements, biases and lags.

        From far away, a sensor's shape, droop and drift would rather explain what placements do.
        """
        layout, su = self.layout, np.zeros_like(self.free_su)
        joint = self.free_joint & (np.arange(layout.n_joint) < layout.gravity)
        su[:, : N_PLACEMENT + 3] = True
        for g in range(layout.n_logs):
            su[:, layout.clock(g).start] = True
        return joint, su & self.free_su

    def _free(self) -> tuple[Bool, Bool]:
        layout, tree, priors = self.layout, self.tree, self.priors
        placements = identifiable(tree, len(self.logs), True)
        joint = np.ones(layout.n_joint, dtype=bool)
        joint[layout.joints] = placements.joints.ravel()
        joint[layout.gravity] = priors.gravity > 0
        joint[layout.compliance] = priors.compliance > 0
        su = np.ones((tree.n_sus, layout.n_su), dtype=bool)
        su[:, :N_SU] = placements.sus
        su[:, N_PLACEMENT:N_SU] &= priors.sensors.deviations > 0
        su[:, layout.front] = priors.front[1] > 0
        resting = tree.su_joint < 0
        for g in range(layout.n_logs):
            su[:, layout.clock(g)] = np.array([priors.lag > 0, priors.drift > 0])
            su[resting, layout.clock(g)] = False
            su[:, layout.knots(g)] = priors.bias_walk > 0
        su[resting, layout.front] = False
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
        log, model = self.moved(state, g), state.placements.model(self.tree)
        up = state.placements.up[g] * state.gravity
        ideal = specific_forces(model, log.q, log.qd, log.qdd, up)
        ideal = filtered(ideal * self._sense(state), log.taps)
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
        return Predicted(residual, measured, ideal[log.kept], rates)

    def moved(self, state: MotionState, g: int) -> Trajectory:
        """A log with the motion of the links, which elastic joints keep from encoders."""
        log = self.logs[g]
        return self.elastic.moved(log, g, state.compliance) if self.elastic else log

    def deflections(self, state: MotionState) -> tuple[F64, ...]:
        """Per log (K, D) by how much links are beyond what encoders say [rad or m]."""
        return tuple((self.moved(state, g).q - log.q)[log.kept] for g, log in enumerate(self.logs))

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
            weights: per log (K, U, 3) information of each sample [s^4/m^2].
            free_su: (U, n) coordinates that may move.
        """
        at = slice(N_PLACEMENT, N_SU)
        free = free_su[:, at]
        _, prior, _, gradient = self.prior_information(state)
        H, g = prior[:, at, at].copy(), gradient[:, at].copy()
        columns = [sensor_columns(p.ideal) for p in predicted]
        for A, p, w in zip(columns, predicted, weights, strict=True):
            r = np.where(p.measured[..., None], p.residual, 0.0)
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

    def _sense(self, state: MotionState) -> float:
        """What sensors read per m/s^2: gravity is what they are held against, whatever it is.

        Their scales do not tell its size: sensors of one kind may share a scale error.
        """
        return self.priors.sensors.gravity / state.gravity

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
            weights: per log (K, U, 3) information of each sample [s^4/m^2]; 0 leaves one out.
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
        return self._with_priors(state, Equations(joint, su, mixed, joint_gradient, su_gradient))

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
        width = max(len(self._joint_columns(u, G - 1)) for u in range(U)) + 2 * max(0, G - 2)
        columns = np.full((U, width), -1)
        joint, su = np.zeros((S, J, J)), np.zeros((S, U, n, n))
        mixed = np.zeros((S, U, n, width))
        joint_scores = np.zeros((1 + n_draws, S, J))
        su_scores = np.zeros((1 + n_draws, S, U, n))
        for u in range(U):
            all_logs = sorted({c for g in range(G) for c in self._joint_columns(u, g)})
            columns[u, : len(all_logs)] = all_logs
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

    def _rows(
        self, state: MotionState, predicted: Sequence[Predicted], weights: Sequence[F64]
    ) -> Iterator[tuple[int, int, list[int], F64, F64]]:
        """Whitened derivatives (C + n, 3, K) and residuals (3, K) of every log and SU."""
        for g in range(len(self.logs)):
            log = self.moved(state, g)
            kept = log.kept
            q, qd, qdd = (np.ascontiguousarray(x[kept].T) for x in (log.q, log.qd, log.qdd))
            up = state.placements.up[g] * state.gravity
            frames = frame_motions(self.tree, state.placements.T_parent_joint, up, q, qd, qdd)
            for u in range(self.tree.n_sus):
                A = self._columns(state, g, u, frames, (q, qd, qdd), predicted[g].rates[:, :, u])
                root = np.sqrt(weights[g][:, u].T)
                residual = np.where(predicted[g].measured[:, u], predicted[g].residual[:, u].T, 0.0)
                yield g, u, self._joint_columns(u, g), A * root, residual * root

    def _joint_columns(self, u: int, g: int) -> list[int]:
        """Columns of the joint part that an SU's readings in a log depend on."""
        layout, chain = self.layout, self.tree.chain(int(self.tree.su_joint[u]))
        columns = [N_JOINT * k + i for k in chain for i in range(N_JOINT)]
        if g > 0:
            columns += range(layout.logs.start + 2 * (g - 1), layout.logs.start + 2 * g)
        columns.append(layout.gravity)
        if self.elastic:
            columns += list(layout.compliance.start + self._bent(u))
        return columns

    def _bent(self, u: int) -> Int:
        """Which of the numbers that joints yield by an SU feels."""
        if self.elastic is None:
            return np.zeros(0, dtype=np.int64)
        chain = self.tree.chain(int(self.tree.su_joint[u]))
        return np.flatnonzero(np.isin(self.elastic.joint, list(chain)))

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
        layout, tree, places = self.layout, self.tree, state.placements
        q, qd, qdd = motion
        K = q.shape[1]
        fixed, carried = frames
        M, sense = places.sensor_matrix()[u], self._sense(state)
        T = places.T_joint_su[u]
        here = placed(carried[int(tree.su_joint[u])], T)
        rows: list[F64] = []
        unseen: dict[int, F64] = {}
        still = np.zeros((3, K))
        path = Path(still + T[:3, 3:4], still, still, np.repeat(T[:3, :3, None], K, axis=2))
        for k in reversed(tree.chain(int(tree.su_joint[u]))):
            path = seen_before_joint(path, bool(tree.prismatic[k]), q[k], qd[k], qdd[k])
            rows.append(placement_columns(fixed[k], path, JOINT_COORDINATES))
            if self.elastic:
                unseen[k] = joint_columns(fixed[k], path, bool(tree.prismatic[k]))
            path = seen_from_parent(path, places.T_parent_joint[k])
        rows.reverse()
        R_su_base = here.R_frame_base
        if g > 0:
            turn = np.cross(np.eye(3)[:2], places.up[g]) * state.gravity
            rows.append(np.einsum("ijk,cj->cik", R_su_base, turn))
        pull = np.einsum("ijk,j->ik", R_su_base, places.up[g] * state.gravity)
        # With gravity grow the accelerations that a reading stands for.
        rows.append((pull - here.f)[None])
        if self.elastic:
            bent = self._bent(u)
            yielding = np.empty((len(bent), 3, K))
            for k, columns in unseen.items():
                of_joint = self.elastic.joint[bent] == k
                e = self._deflections[g][:, bent[of_joint]]
                yielding[of_joint] = -np.einsum("dck,dsk->sck", columns, e)
            rows.append(yielding)
        around = Path(still, still, still, np.repeat(np.eye(3)[:, :, None], K, axis=2))
        rows.append(placement_columns(here, around, tuple(range(N_PLACEMENT))))
        ideal = np.concatenate(rows)
        C = len(ideal) - N_PLACEMENT
        out = np.zeros((C + layout.n_su, 3, K))
        out[: C + N_PLACEMENT] = np.einsum("ij,cjk->cik", M * sense, ideal)
        own = out[C:]
        own[N_PLACEMENT:N_SU] = sensor_columns(here.f.T[:, None] * sense)[:, 0].transpose(1, 2, 0)
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
        layout, priors, places = self.layout, self.priors, state.placements
        U = self.tree.n_sus
        joint, su = np.zeros(layout.n_joint), np.zeros((U, layout.n_su, layout.n_su))
        joint_gradient, su_gradient = np.zeros(layout.n_joint), np.zeros((U, layout.n_su))

        def inverse(deviation: F64 | float) -> F64:
            d = np.asarray(deviation, dtype=np.float64)
            return np.divide(1.0, d**2, out=np.zeros_like(d), where=d > 0)

        joint[layout.gravity] = inverse(priors.gravity / state.gravity)
        joint_gradient[layout.gravity] = -joint[layout.gravity] * (1 - self._sense(state))
        joint[layout.compliance] = inverse(priors.compliance)
        joint_gradient[layout.compliance] = -joint[layout.compliance] * state.compliance
        of_su = np.zeros(layout.n_su)
        of_su[N_PLACEMENT:N_SU] = inverse(priors.sensors.deviations)
        of_su[layout.front] = inverse(priors.front[1])
        value = np.zeros((U, layout.n_su))
        value[:, N_PLACEMENT:N_SU] = np.concatenate([places.bias, places.shape], axis=1)
        value[:, layout.front] = state.front - priors.front[0]
        for g in range(layout.n_logs):
            of_su[layout.clock(g)] = inverse(np.array([priors.lag, priors.drift]))
            value[:, layout.clock(g)] = state.clock[g]
        su[:, range(layout.n_su), range(layout.n_su)] = of_su
        su_gradient -= of_su * value
        for g, n in enumerate(layout.n_knots):
            if n and priors.bias_walk > 0:
                step = (self.logs[g].time[-1] - self.logs[g].time[0]) / (n - 1)
                D = np.diff(np.eye(n), axis=0)
                walk = D.T @ D * inverse(priors.bias_walk) / step
                # The walk begins anywhere near the SU's own bias, which its mean is to be.
                walk += np.ones((n, n)) / n**2 * inverse(priors.bias_walk) / step * n
                full = np.kron(walk, np.eye(3))
                at = layout.knots(g)
                su[:, at, at] += full
                flat = state.knots[g].swapaxes(0, 1).reshape(U, -1)
                su_gradient[:, at] -= flat @ full
        return joint, su, joint_gradient, su_gradient

    def _with_priors(self, state: MotionState, data: Equations) -> Equations:
        joint, su, joint_gradient, su_gradient = self.prior_information(state)
        places, weight = state.placements, self.priors.sensors.position**-2.0
        D = self.tree.n_joints
        held = np.zeros(data.joint.shape[0])
        pulled = np.zeros_like(held)
        # An offset not known is to be short; its gradient is that along the frame's own axes.
        local = np.einsum(
            "dji,dj->di", places.T_parent_joint[:, :3, :3], places.T_parent_joint[:, :3, 3]
        )
        for i in (0, 1):
            held[N_JOINT * np.arange(D) + i] = weight
            pulled[N_JOINT * np.arange(D) + i] = -weight * local[:, i]
        su = np.array(su)
        su_gradient = np.array(su_gradient)
        at_su = np.einsum("uji,uj->ui", places.T_joint_su[:, :3, :3], places.T_joint_su[:, :3, 3])
        su[:, range(3), range(3)] += weight
        su_gradient[:, :3] -= weight * at_su
        return replace(
            data,
            joint=data.joint + np.diag(joint + held),
            su=data.su + su,
            joint_gradient=data.joint_gradient + joint_gradient + pulled,
            su_gradient=data.su_gradient + su_gradient,
        )

    def prior_chi2(self, state: MotionState) -> float:
        """Chi-squared of the priors at a state."""
        joint, su, joint_gradient, su_gradient = self.prior_information(state)
        places, weight = state.placements, self.priors.sensors.position**-2.0
        total: float = weight * float((places.T_parent_joint[:, :3, 3] ** 2).sum())
        total += weight * float((places.T_joint_su[:, :3, 3] ** 2).sum())
        known = joint > 0
        total += float((joint_gradient[known] ** 2 / joint[known]).sum())
        for H, s in zip(su, su_gradient, strict=True):
            has = np.diag(H) > 0
            total += float(s[has] @ np.linalg.solve(H[np.ix_(has, has)], s[has]))
        return total


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
