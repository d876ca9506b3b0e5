"""Residuals of all samples along the logs, and their normal equations in arrow form."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property, partial

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.estimation.problem.state import (
    N_PLACEMENT,
    N_SU,
    identifiable,
)
from skin2urdf.estimation.trajectory.azimuth import turned
from skin2urdf.estimation.trajectory.derivatives import (
    SENSES,
    Carried,
    Derivatives,
    compared,
    fixed_path,
)
from skin2urdf.estimation.trajectory.front_end import Spectrum, front_end
from skin2urdf.estimation.trajectory.gyro import predicted_turning
from skin2urdf.estimation.trajectory.heights import rise
from skin2urdf.estimation.trajectory.kinematics import (
    joint_columns,
    seen_before_joint,
    seen_from_parent,
)
from skin2urdf.estimation.trajectory.links import LinkRows
from skin2urdf.estimation.trajectory.normal_equations import Block, Sums, blocks_of
from skin2urdf.estimation.trajectory.points import SharedPoints
from skin2urdf.estimation.trajectory.priors import (
    MotionPriors,
    prior_chi2,
    prior_information,
    sense,
    with_priors,
)
from skin2urdf.estimation.trajectory.records import Equations, Predicted
from skin2urdf.estimation.trajectory.skeleton import N_HINGES, joints_on_hinges
from skin2urdf.estimation.trajectory.state import N_GYRO, MotionState
from skin2urdf.model.records import KinematicModel
from skin2urdf.model.specific_force import forces_in_time
from skin2urdf.signals.filters import FIRST_DIFFERENCES, passed
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.threads import do_each

_HELD = 1e-6
"""Deviation by which what nothing shows is held [m or rad]: far less than is stated of any."""
_TOGETHER = 4096
"""Samples of the grid that are predicted at once: as many as caches hold of a chain of joints."""


class MotionProblem(Derivatives):
    """Chi-squared of all samples of all logs, of what :class:`Derivatives` takes."""

    @property
    def free_joint(self) -> Bool:
        """(J,) coordinates of the joint part that are estimated."""
        return self._free[0]

    @property
    def free_su(self) -> Bool:
        """(U, n) coordinates of the SUs that are estimated."""
        return self._free[1]

    def chosen(self, state: MotionState) -> F64:
        """(H, J) unit vectors along which the robot stands as one chooses, and nothing shows.

        Its height (:mod:`heights`) and how it is turned about gravity (:mod:`azimuth`); none where
        no motion of the base is followed by its loads, or the robot is known.
        """
        unseen, places = self.unseen, state.placements
        follows = self.base_swings and unseen is not None and unseen.settled
        if not follows or self.priors.blueprint is not None:
            return np.zeros((0, self.layout.n_joint))
        ways = rise(self.tree, places)[0], turned(self.tree, places, places.up[0])[0]
        out = np.zeros((len(ways), self.layout.n_joint))
        out[:, self.layout.joints] = [way.ravel() for way in ways]
        return np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True).clip(min=1e-300))

    def again(
        self, *, logs: Sequence[Trajectory] | None = None, priors: MotionPriors | None = None
    ) -> MotionProblem:
        """The same problem with other logs, or with something else known before."""
        new = MotionProblem(
            self.tree,
            self.logs if logs is None else logs,
            priors or self.priors,
            self.layout.n_knots,
            self.unseen,
        )
        if logs is None and "_motions" in vars(self):
            vars(new)["_motions"] = self._motions
        return new

    def stiff(self) -> MotionProblem:
        """The same problem of a robot of which encoders see all."""
        priors = replace(self.priors, unseen=np.zeros(0))
        return MotionProblem(self.tree, self.logs, priors, self.layout.n_knots)

    def coarse(self, *, unseen: bool = False, lags: bool = True) -> tuple[Bool, Bool]:
        """Coordinates (J,) and (U, n) to begin with: placements, biases and lags.

        From far away, a sensor's shape, droop and drift would rather explain what placements do.

        Args:
            unseen: whether what encoders do not see is to be found from the beginning as well.
            lags: whether lags are.
        """
        layout, su = self.layout, np.zeros_like(self.free_su)
        joint = self.free_joint & (np.arange(layout.n_joint) < layout.gravity)
        joint[layout.further] = self.free_joint[layout.further]
        if unseen:
            joint[layout.unseen] = self.free_joint[layout.unseen]
        su[:, : N_PLACEMENT + 3] = True
        for g in range(layout.n_logs):
            su[:, layout.clock(g).start] = lags
        if layout.gyros:
            su[:, layout.gyro.start + N_GYRO : layout.gyro.stop] = True
        return joint, su & self.free_su

    @property
    def base_swings(self) -> bool:
        """Whether SUs feel the base accelerate."""
        return self.unseen is not None and self.unseen.swings_base(self.tree.n_joints)

    @cached_property
    def between_limbs(self) -> Int:
        """Coordinates of the joint part that tell where limbs are, if only the base shows it."""
        if not self.base_swings or self.priors.blueprint is not None:
            return np.zeros(0, dtype=np.int64)
        still = identifiable(self.tree, 1).joints
        return np.flatnonzero((joints_on_hinges(self.tree) & ~still).ravel())

    @cached_property
    def _free(self) -> tuple[Bool, Bool]:
        layout, tree, priors = self.layout, self.tree, self.priors
        placements = identifiable(tree, len(self.logs), True)
        joint = np.ones(layout.n_joint, dtype=bool)
        joint[layout.joints] = placements.joints.ravel()
        joint[self.between_limbs] = True
        if priors.blueprint:
            joint[layout.joints], joint[layout.further] = priors.blueprint.free()
        joint[layout.gravity] = priors.gravity > 0
        joint[layout.unseen] = priors.unseen > 0
        su = np.ones((tree.n_sus, layout.n_su), dtype=bool)
        su[:, :N_SU] = placements.sus
        su[:, N_PLACEMENT:N_SU] &= priors.sensors.deviations > 0
        su[:, layout.front] = priors.front[1] > 0
        # On a base that gives way, an SU shows where it is, and when it reads and how.
        resting = (tree.su_joint < 0) & (not self.base_swings)
        if self.base_swings:
            su[:, :3] = True
        for g in range(layout.n_logs):
            su[:, layout.clock(g)] = np.array([priors.lag > 0, priors.drift > 0])
            su[resting, layout.clock(g)] = False
            su[:, layout.knots(g)] = priors.bias_walk > 0
            su[resting, layout.warming(g)] = False
        su[:, layout.curvature] = True
        su[resting, layout.front] = False
        su[resting, layout.curvature] = False
        su[~np.any([log.valid.any(axis=0) for log in self.logs], axis=0)] = False
        if layout.gyros:
            of_log = np.tile(priors.gyro[N_GYRO:], layout.n_logs)
            known = np.concatenate([priors.gyro[:N_GYRO], of_log])
            su[:, layout.gyro] = self.gyros[:, None] & (known > 0)
        return joint, su

    def predict(self, state: MotionState, g: int) -> Predicted:
        """Residuals of one log."""
        log, places = self.moved(state, g), state.placements
        felt = self._felt_by_points(state, log, g)
        at, shares, course = self.read_at(state, g), self.knot_shares(g), self.course(g)
        # What belongs to an SU lies in one piece: with many of them, all else is far away.
        residual = np.empty((self.tree.n_sus, 3, len(log.kept))).transpose(2, 0, 1)
        matrices, splines = places.sensor_matrix(), self.logs[g].splines
        within, rate, margin = compared(log)

        def compare(part: tuple[SharedPoints, Spectrum]) -> None:
            some, of_points = part
            heard = of_points.mixed(some.sensed(matrices[some.sus]))
            read = front_end(heard, state.front[some.sus])[..., within]
            for u, mine in zip(some.sus, read, strict=True):
                bias = places.bias[u] + shares @ state.knots[g][:, u]
                residual[:, u] = splines[u].at(at[:, u]) - mine.T - bias
                if self.layout.curves:
                    residual[:, u] -= state.curvature[u] * mine.T**2
                if self.layout.warms:
                    residual[:, u] -= (course @ state.warming[g][u]) * mine.T

        of_links = (
            (link, Spectrum.of(link.series(felt[:, :3]), rate, margin))
            for link in self.points(state)
        )
        parts = ((some, of_points) for link, of_points in of_links for some in link.parts())
        do_each(compare, parts, self.tree.n_sus)
        if log.beyond is not None:
            residual -= log.beyond[..., :3]
        measured = log.valid & np.isfinite(residual).all(axis=2)
        links = self.skeleton.numbers
        turned = predicted_turning(
            self.skeleton.model(places.T_parent_joint, places.T_joint_su),
            self.logs[g], (log.q[:, links], log.qd[:, links]), state, g, self.lags(state, g),
        )  # fmt: skip
        return Predicted(residual, measured, felt, turned=turned)

    def _felt_by_points(self, state: MotionState, log: Trajectory, g: int) -> F64:
        """(P, 6, M) specific force at all points and its derivative, M from end to end of a log."""
        places, tree, links = state.placements, self.skeleton.tree, self.points(state)
        T = np.tile(np.eye(4), (links[-1].at.stop, 1, 1))
        for link in links:
            T[link.at, :3, 3] = link.arms
        carried_by = np.repeat([link.joint for link in links], [len(link.arms) for link in links])
        tree = replace(tree, su_names=tuple(map(str, range(len(T)))), su_joint=carried_by)
        model = KinematicModel(tree, self.skeleton.placements(places.T_parent_joint), T)
        moved = [x.T[self.skeleton.numbers] for x in (log.q, log.qd, log.qdd)]
        up = places.up[g] * state.gravity
        slope = np.convolve(log.taps, FIRST_DIFFERENCES * log.rate)
        filters = np.stack([np.pad(log.taps, len(FIRST_DIFFERENCES) // 2), slope])
        filters *= sense(self.priors, state)
        # Low-passed, nothing is lost at the rate of the samples that are compared.
        at = np.arange(int(log.kept[0]) % log.every, len(log.q), log.every)
        out, reach = np.empty((len(T), 6, len(at))), filters.shape[1] // 2
        for begin in range(0, len(at), -(-_TOGETHER // log.every)):
            some = slice(begin, begin + -(-_TOGETHER // log.every))
            first, last = at[some][0] - reach, at[some][-1] + reach
            # Ends repeat the outermost samples.
            here = np.arange(first, last + 1).clip(0, len(log.q) - 1)
            q, qd, qdd = (x[:, here] for x in moved)
            force = forces_in_time(model, q, qd, qdd, up)
            both = passed(force.reshape(-1, len(here)), filters, log.every)
            both = both.reshape(len(T), 3, 2, -1).swapaxes(1, 2)
            out[:, :, some] = both.reshape(len(T), 6, -1)
        return out

    def ideal(
        self, state: MotionState, g: int, predicted: Predicted, use: Callable[[int, F64], object]
    ) -> None:
        """Use what perfect sensors in the SUs' places would read, behind their front ends.

        Args:
            state: where.
            g: number of the log.
            predicted: the log held against the state.
            use: is called with the number of each SU and what it would read, (3, K) [m/s^2]; for
                several at a time where there are many.
        """
        within, rate, margin = compared(self.logs[g])
        perfect = np.broadcast_to(np.eye(3), (self.tree.n_sus, 3, 3))

        def read(part: tuple[SharedPoints, Spectrum]) -> None:
            some, of_points = part
            heard = of_points.mixed(some.sensed(perfect[some.sus]))
            read = front_end(heard, state.front[some.sus])[..., within]
            for u, mine in zip(some.sus.tolist(), read, strict=True):
                use(u, mine)

        of_links = (
            (link, Spectrum.of(link.series(predicted.felt[:, :3]), rate, margin))
            for link in self.points(state)
        )
        parts = ((some, of_points) for link, of_points in of_links for some in link.parts())
        do_each(read, parts, self.tree.n_sus)

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
    ) -> MotionState:
        """The best bias and shape of every SU for its placement, a linear problem.

        Where gravity stands still in an SU, its tilt and its bias can hardly be told apart. The
        pairs that explain the readings form an arc, which a step in both leaves; this leads back.

        Args:
            state: placements, and sensors to begin with.
            predicted: residuals of each log there, which are changed in place: with many SUs each
                array of them is large.
            weights: per log (K, U, 3) information of each sample [s^4/m^2]; gyroscopes' behind it.
            free_su: (U, n) coordinates that may move.
        """
        at = slice(N_PLACEMENT, N_SU)
        free = free_su[:, at]
        _, prior, _, gradient = self.prior_information(state)
        moments, pulls = np.zeros((len(free), 3, 4, 4)), np.zeros((len(free), 3, 4))
        for g, (p, w) in enumerate(zip(predicted, weights, strict=True)):

            def add(u: int, ideal: F64, p: Predicted = p, w: F64 = w) -> None:
                felt = np.concatenate([np.ones((1, ideal.shape[1])), ideal])
                weighed = w[:, u, :3].T[:, None] * felt
                left = np.where(p.measured[:, u], p.residual[:, u].T, 0.0)
                moments[u] += weighed @ felt.T
                pulls[u] += (weighed @ left[:, :, None])[..., 0]

            self.ideal(state, g, p, add)
        H = prior[:, at, at] + np.einsum("ica,uiab,idb->ucd", SENSES, moments, SENSES)
        b = gradient[:, at] + np.einsum("ica,uia->uc", SENSES, pulls)
        H = np.where(free[:, :, None] & free[:, None], H, 0.0) + np.eye(H.shape[1]) * ~free[:, None]
        x = np.linalg.solve(H, np.where(free, b, 0.0)[..., None])[..., 0]
        places = replace(
            state.placements,
            bias=state.placements.bias + x[:, :3],
            shape=state.placements.shape + x[:, 3:],
        )
        for g, p in enumerate(predicted):

            def take_off(u: int, ideal: F64, residual: F64 = p.residual) -> None:
                by_felt = np.tensordot(x[u], SENSES, (0, 1))
                residual[:, u] -= (by_felt[:, 1:] @ ideal + by_felt[:, :1]).T

            self.ideal(state, g, p, take_off)
        return replace(state, placements=places)

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
        sums, beyond = Sums.nothing(self.layout, self.tree.n_sus), self.beyond()
        heard: list[tuple[LinkRows, Carried]] = []

        def parts() -> Iterator[Callable[[], None]]:
            for link, carried in self.links(state, predicted, weights):
                unseen = beyond[link.log] if beyond else None
                if not link.shared:
                    for rows in self._rows_of(state, link, carried):
                        sums.add(rows, unseen)
                    continue
                blocks = sums.add_joints(link, unseen)
                for some, own in self.own_parts(state, link, carried):
                    yield partial(_add_sus, sums, link, some, own, blocks)
                if self.gyros[link.sus].any():
                    heard.append((link, carried))

        do_each(lambda add: add(), parts(), self.tree.n_sus)
        for link, carried in heard:
            for u in link.sus.tolist():
                for rows in self.gyro_rows(state, link.log, u, carried):
                    sums.add(rows, beyond[link.log] if beyond else None)
        chosen = self.chosen(state)
        sums.joint[:] += chosen.T @ chosen / _HELD**2
        return with_priors(self.priors, self.layout, self._seconds, state, sums.equations())

    def gradients(
        self,
        state: MotionState,
        predicted: Sequence[Predicted],
        pulls: Sequence[Sequence[F64]],
    ) -> list[tuple[F64, F64]]:
        """Gradients (J,) and (U, n) that residuals of accelerometers would make, without priors.

        Args:
            state: where.
            predicted: each log held against the state, of which residuals do not count.
            pulls: several times, per log (K, U, 3), residuals times their information, 0 where
                nothing is measured [s^2/m].

        Returns:
            As many.
        """
        every, beyond = [Sums.nothing(self.layout, self.tree.n_sus) for _ in pulls], self.beyond()

        def parts() -> Iterator[Callable[[], None]]:
            for link, carried in self.links(state, predicted, [np.ones_like(p) for p in pulls[0]]):
                links = [
                    replace(link, residual=np.ascontiguousarray(np.moveaxis(p[:, link.sus], 0, 2)))
                    for p in (each[link.log] for each in pulls)
                ]
                blocks = list(blocks_of(link, beyond[link.log] if beyond else None))
                for sums, pulled in zip(every, links, strict=True):
                    sums.pull_joints(pulled, blocks)
                for some, own in self.own_parts(state, link, carried):
                    yield partial(_pull_sus, every, links, some, own)

        do_each(lambda pull: pull(), parts(), self.tree.n_sus)
        return [(sums.joint_gradient, sums.su_gradient) for sums in every]

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
        D = self.tree.n_joints
        out = [(np.zeros((D, 3, len(w))), np.zeros((D, 3, 3, len(w)))) for w in weights]
        for g, link, chain, by_motion in self._moved_links(state):
            p, w, sensed = predicted[g], weights[g][:, link.sus, :3], self._sensed(state, link)
            left = np.where(p.measured[:, link.sus, None], p.residual[:, link.sus], 0.0)
            pulls = np.einsum("ksi,sip->pk", w * left, sensed, optimize=True)
            N = np.einsum("ksi,sip,siq->pqk", w, sensed, sensed, optimize=True)
            weighed = np.einsum("pqk,mdqk->mdpk", N, by_motion)
            G, H = out[g]
            G[chain] += np.einsum("mdpk,pk->mdk", by_motion, pulls)
            H[chain] += np.einsum("mdpk,mepk->mdek", by_motion, weighed)
        return out

    def _sensed(self, state: MotionState, link: SharedPoints) -> F64:
        """(S, 3, 3 p) what makes the readings of a link's SUs of what its points feel."""
        matrices = state.placements.sensor_matrix() * sense(self.priors, state)
        return np.asarray(link.sensed(matrices[link.sus]))

    def _moved_links(
        self, state: MotionState
    ) -> Iterator[tuple[int, SharedPoints, list[int], F64]]:
        """Logs, links, the m joints before each, and (m, 3, 3 p, K) what its points feel of these.

        Of their positions, velocities and accelerations.
        """
        first = len(self.skeleton.hinges)
        for g in range(len(self.logs)):
            motion, (fixed, _) = self._frames(state, g)
            for link in self.points(state):
                chain = [k - first for k in self._chain(int(link.sus[0])) if k >= first]
                by_motion = np.empty((len(chain), 3, 3 * len(link.arms), motion[0].shape[1]))
                for i, arm in enumerate(link.arms):
                    T = np.eye(4)
                    T[:3, 3] = arm
                    path = fixed_path(T, motion[0].shape[1])
                    for place, k in reversed(list(enumerate(chain))):
                        slides = bool(self.tree.prismatic[k])
                        path = seen_before_joint(path, slides, *(x[first + k] for x in motion))
                        columns = joint_columns(fixed[first + k], path, slides)
                        by_motion[place, :, 3 * i : 3 * i + 3] = columns
                        path = seen_from_parent(path, state.placements.T_parent_joint[k])
                yield g, link, chain, by_motion

    def prior_information(self, state: MotionState) -> tuple[F64, F64, F64, F64]:
        """Information (J,) and (U, n, n) of the priors and their gradients (J,) and (U, n)."""
        return prior_information(self.priors, self.layout, self._seconds, state)

    def with_other_priors(
        self, equations: Equations, state: MotionState, before: MotionProblem
    ) -> Equations:
        """Equations of the same samples with what is known now in place of what was before.

        Args:
            equations: of the problem as it was.
            state: where.
            before: that problem, of which offsets were known as well.
        """
        known, was = self.prior_information(state), before.prior_information(state)
        joint, su, to_joint, to_su = (new - old for new, old in zip(known, was, strict=True))
        return Equations(
            joint=equations.joint + np.diag(joint),
            su=equations.su + su,
            mixed=equations.mixed,
            joint_gradient=equations.joint_gradient + to_joint,
            su_gradient=equations.su_gradient + to_su,
        )

    def prior_chi2(self, state: MotionState) -> float:
        """Chi-squared of the priors at a state."""
        return prior_chi2(self.priors, self.layout, self._seconds, state)


def _add_sus(
    sums: Sums, link: LinkRows, some: slice, own: Callable[[], F64], blocks: list[Block]
) -> None:
    """Add what some SUs of a link say of their own parts."""
    sums.add_sus(link, some, own(), blocks)


def _pull_sus(
    every: Sequence[Sums], links: Sequence[LinkRows], some: slice, own: Callable[[], F64]
) -> None:
    """Add what several residuals of some SUs of a link say of their own parts."""
    derivatives = own()
    for sums, pulled in zip(every, links, strict=True):
        sums.pull_sus(pulled, some, derivatives)
