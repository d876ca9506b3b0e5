"""All samples of the logs, moves between poses included: the last and widest look at them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.calibration.clock import Tell
from skin2urdf.calibration.result import GOOD_FIT
from skin2urdf.calibration.rounds import Logs, Solution
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import N_JOINT, N_PLACEMENT
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.estimation.trajectory.attempt import BENDS, CERTAIN, CLOCK, PLAY
from skin2urdf.estimation.trajectory.estimate import (
    MotionEstimate,
    estimate_along,
    motion_priors,
)
from skin2urdf.estimation.trajectory.fit import independent
from skin2urdf.estimation.trajectory.front_end import common_front_end
from skin2urdf.estimation.trajectory.kinematics import levers
from skin2urdf.estimation.trajectory.priors import MotionPriors
from skin2urdf.estimation.uncertainty.health import are_plausible
from skin2urdf.signals.clocks import as_far_as_confirmed, is_off
from skin2urdf.signals.records import Features, JointClock, SuClock
from skin2urdf.signals.sampling import Sampled
from skin2urdf.signals.trajectory import Trajectory, in_order, trajectory
from skin2urdf.structure.ordering import places_of
from skin2urdf.structure.unknown_positions import usable

_SETTLED = 5e-3
"""By how much clocks may still be off once features were taken [s]: nothing is compared so near to
a gap."""
_HIT = 3.0
"""Mean size of what is left during a hit, in standard deviations of noise, from which it is one."""
_MOMENT = 0.5
"""Length of moments that may stand out [s]: about that of the shortest hit that matters."""
_OF_PLACES = frozenset({"encoder jump", "encoder scale", "loose"})
"""Faults that leave what is felt off by other amounts from place to place."""
_STAYS = 0.5
"""Share of the slack that stays where encoders were mended that had nothing."""
_MOST = 0.5
"""Share of the moments, around poses and between, from which samples say all that features do."""


def fit_samples(
    solution: Solution,
    tell: Tell,
    *,
    most: float = np.inf,
    without: Collection[str] = (),
    look_further: bool = True,
) -> MotionEstimate | None:
    """Fit all samples of mended logs, starting from what the features around poses say.

    Args:
        solution: the logs, and the estimate to begin with.
        tell: told the share of the work that is done.
        most: misfit beyond which no physics is tried that a rigid robot has not.
        without: causes that need not be tried, see :func:`rejected`.
        look_further: whether any is tried.

    Returns:
        None where most moments are around poses that have no samples to compare, as rests that were
        recorded one by one: filters reach beyond them, and the few samples that are left know less
        than the features.
    """
    found, features, logs = solution.found, solution.features, solution.logs
    tree, settings = found.tree, logs.settings
    sus = places_of(tree.su_names, logs.su_names)
    latency = features.latency[places_of(tree.su_names, features.su_names)]
    reach = float(np.abs(latency).max(initial=0.0)) + _SETTLED
    use = usable(features, tree)
    trajectories = []
    for log, sampled in enumerate(logs.sampled):
        dofs = places_of(tree.joint_names, sampled.motion.dof_names)
        whole = in_order(trajectory(sampled, log, reach, sus), dofs, np.arange(tree.n_sus))
        mine = features.log == log
        # What lies beyond a joint whose position the log lacks tells nothing.
        tells = use[mine].any(axis=0) if mine.any() else np.ones(tree.n_sus, dtype=bool)
        trajectories.append(
            replace(
                whole,
                valid=whole.valid & tells,
                turning=None if whole.turning is None else whole.turning & tells,
            )
        )
    if _share_compared(trajectories, logs.sampled) < _MOST:
        return None
    priors = sample_priors(settings, found.cost.priors)
    return estimate_along(
        independent(trajectories), tree, found.state, priors, latency, tell,
        most=most, without=without, look_further=look_further,
        alike=settings.estimation.intrinsics, mended=_mended(logs.sampled, tree.su_names),
    )  # fmt: skip


def _mended(sampled: Sequence[Sampled], names: Sequence[str]) -> F64:
    """(G, U, 2) latency [s] and drift [1] that were taken off the stamps of SUs (U,)."""
    out = np.zeros((len(sampled), len(names), 2))
    for g, s in enumerate(sampled):
        known = {clock.su: clock for clock in s.clocks}
        for u, name in enumerate(names):
            if name in known:
                out[g, u] = known[name].latency, known[name].drift
    return out


def rejected(along: MotionEstimate | None) -> frozenset[str]:
    """Causes that a fit of nearly the same logs has tried, and that explained less than others."""
    return frozenset(along.tried) - frozenset(along.causes) if along else frozenset()


def sample_priors(settings: CalibrationSettings, sensors: Priors) -> MotionPriors:
    """What is known before all samples are fitted.

    Args:
        settings: choices.
        sensors: what is known of the sensors.
    """
    front = np.zeros(2), np.full(2, settings.slowest_pole**2)
    if settings.bandwidth is not None:
        front = common_front_end(*settings.bandwidth)
    if not settings.estimation.intrinsics:
        sensors = replace(sensors, bias=0.0, scale=0.0, cross=0.0)
        front = np.zeros(2), np.zeros(2)
    return motion_priors(
        sensors,
        gravity=settings.gravity_deviation,
        front=front,
        gyro=settings.estimation.intrinsics,
    )


def late_publishers(
    along: MotionEstimate | None, sampled: Sequence[Sampled]
) -> tuple[tuple[JointClock, ...], ...]:
    """Clocks of publishers of joint states that all samples show to be off, by log.

    Args:
        along: the fit of all samples, if there is one.
        sampled: the logs.
    """
    out: list[list[JointClock]] = [[] for _ in sampled]
    late = None if along is None else along.late
    if along is None or late is None:
        return tuple(tuple(each) for each in out)
    names = along.problem.tree.joint_names
    for c, (g, joints) in enumerate(zip(late.log.tolist(), late.joints, strict=True)):
        time = along.problem.logs[g].time
        out[g].append(
            JointClock(
                joints=tuple(names[j] for j in joints),
                latency=float(late.latency[c]),
                latency_sd=float(late.latency_sd[c]),
                drift=float(late.drift[c]),
                drift_sd=float(late.drift_sd[c]),
                middle=sampled[g].motion.grid.start + 0.5 * float(time[0] + time[-1]),
            )
        )
    return tuple(tuple(each) for each in out)


def clocks_in_all(
    clocks: Sequence[Sequence[SuClock]], along: MotionEstimate | None
) -> tuple[tuple[SuClock, ...], ...]:
    """Clocks that were set right before all else, with what all samples still found of them.

    Args:
        clocks: by log, the SUs whose clock ran differently from the joints'.
        along: the fit of all samples, if there is one.

    Returns:
        The same clocks: latency and drift as the fit leaves them, and its deviations.
    """
    if along is None:
        return tuple(tuple(of_log) for of_log in clocks)
    names, layout = along.problem.tree.su_names, along.problem.layout
    found, variances = along.fitted.state.clock, np.einsum("uii->ui", along.su_covariances)

    def fitted(clock: SuClock, log: int) -> SuClock:
        if clock.su not in names:
            return clock
        u = names.index(clock.su)
        late, fast = map(float, found[log, u])
        late_sd, fast_sd = map(float, np.sqrt(variances[u, layout.clock(log)].clip(0.0)))
        if late_sd > clock.latency_sd:
            # Its readings do not show it: it runs on the clock that all others share.
            return clock
        return replace(
            clock,
            latency=clock.latency + late,
            latency_sd=late_sd,
            drift=clock.drift + fast,
            drift_sd=fast_sd,
        )

    return tuple(tuple(fitted(clock, g) for clock in of_log) for g, of_log in enumerate(clocks))


def late_sus(
    along: MotionEstimate | None, sampled: Sequence[Sampled], features: Features
) -> tuple[tuple[SuClock, ...], ...]:
    """Clocks of SUs that only all samples show to be off, by log.

    Args:
        along: the fit of all samples, if there is one.
        sampled: the logs, which name the clocks that were set right before.
        features: those around poses; a latency that they show is told as such.
    """
    out: list[list[SuClock]] = [[] for _ in sampled]
    if along is None:
        return tuple(tuple(each) for each in out)
    layout, variances = along.problem.layout, np.einsum("uii->ui", along.su_covariances)
    shown = dict(zip(features.su_names, np.isfinite(features.latency_sd), strict=True))
    for g, s in enumerate(sampled):
        time = along.problem.logs[g].time
        middle = s.motion.grid.start + 0.5 * float(time[0] + time[-1])
        known = {clock.su for clock in s.clocks}
        for u, name in enumerate(along.problem.tree.su_names):
            if name in known or shown.get(name, False):
                continue
            late, fast = map(float, along.fitted.state.clock[g, u])
            late_sd, fast_sd = map(float, np.sqrt(variances[u, layout.clock(g)].clip(0.0)))
            clock = as_far_as_confirmed(
                SuClock(name, late, late_sd, fast, fast_sd, middle), s.motion
            )
            if is_off(clock, s.motion):
                out[g].append(clock)
    return tuple(tuple(each) for each in out)


def is_explained_by_physics(along: MotionEstimate) -> bool:
    """Whether what real robots have explains all samples, so that nothing need be wrong.

    Features are of second order in the patterns, and tell less of abrupt ones than samples do. An
    elastic gear, an uneven one or a drifting bias makes patterns look as if joints were hit or
    encoders bent; so these are tried before anything is said to be wrong. Slack from place to place
    explains nothing by a cause, nor does a sensor with a scale that none has, as a mirrored one
    seems to; what stands out at some moment is left to the search.

    Args:
        along: the fit of all samples of logs that nothing was mended in.
    """
    if "slack" in along.causes or not are_plausible(along.state).all():
        return False
    return along.misfit <= GOOD_FIT and not _anything_stands_out(along)


def leaves_only_noise(along: MotionEstimate) -> bool:
    """Whether no SU shows more than noise, over spans of time or at any moment."""
    quiet = np.nan_to_num(along.misfit_of_sus) <= 1 + along.scatter
    return bool(quiet.all()) and not _anything_stands_out(along)


def _anything_stands_out(along: MotionEstimate) -> bool:
    """Whether any half second of an SU is far from what noise and all that was found leave.

    What yields is followed as slowly as it moves; a spring that is let go overshoots by as much
    again, and rings on.
    """
    problem, fitted = along.problem, along.fitted
    unseen = problem.unseen
    stiff = problem.stiff() if unseen else problem
    at = replace(fitted.state, unseen=np.zeros(stiff.layout.n_unseen))
    for g, (log, p) in enumerate(zip(problem.logs, fitted.predicted, strict=True)):
        size = max(1, round(_MOMENT * len(log.kept) / float(log.time[-1] - log.time[0])))
        first = np.arange(0, len(log.kept), size)
        count = np.diff(np.append(first, len(log.kept)))

        noise = _usual(along, g)
        left = _mean_squares(p.residual / noise, p.measured, first, count)
        if unseen:
            by_spring = (stiff.predict(at, g).residual - p.residual) / noise
            bent = _mean_squares(by_spring, p.measured, first, count)
            before = np.concatenate([bent[:1], bent[:-1]])
            left /= 1 + np.maximum(bent, before)
        if left.max() > _HIT**2:
            return True
    return False


def _mean_squares(x: F64, measured: Bool, first: Int, count: Int) -> F64:
    """(moments, U) mean squares of what is measured of x (K, U, 3), a moment from each first on."""
    seen = np.where(measured[..., None], x, 0.0) ** 2
    return np.asarray(np.add.reduceat(seen.mean(axis=2), first, axis=0) / count[:, None])


def without_false_hits(
    solution: Solution, along: MotionEstimate, whole: Logs, first: Solution | None, tell: Tell
) -> tuple[Solution, MotionEstimate]:
    """Hits that all samples explain, those that were left out included, are none.

    What a slow sensor or an elastic gear does to a pattern looks like a hit, or like an SU that
    came loose, as long as the model lacks it, and is explained once the fit has it.

    Args:
        solution: the estimate, with hits among its faults.
        along: the fit of its logs, without the moments of the hits.
        whole: the logs with them.
        first: the estimate before anything was taken to be wrong; None where there is none.
        tell: told the share of the work that is done.
    """
    kinds = {fault.kind for fault in solution.faults}
    if not kinds or not kinds <= {"contact", "loose"}:
        return solution, along
    loose = "loose" in kinds
    # An SU that came loose is two in the tree of what was mended.
    everything = first if loose else replace(solution, logs=whole)
    if everything is None:
        return solution, along
    # An SU that did leaves so much that every cause would be tried in vain. So would they be where
    # the logs without the hits leave only noise to a stiff robot on steady clocks: what yields or
    # wanders shows there as well.
    stiff = not set(along.causes) & {*BENDS, PLAY, CLOCK} and (loose or leaves_only_noise(along))
    most = 0.0 if stiff else np.inf
    again = fit_samples(everything, tell, without=rejected(along), most=most)
    if again is None:
        return solution, along
    if loose and not leaves_only_noise(again) and not differs_by_physics(solution, along, again):
        return solution, along
    real = tuple(
        f for f in solution.faults
        if f.kind == "contact"
        and stands_out(again, whole.sampled, f.log or 0, f.begin, f.end, pushed=f.subject)
    )  # fmt: skip
    if real:
        return (solution if loose else replace(solution, faults=real)), along
    return replace(everything, faults=()), again


def names_what_differs_by_place(solution: Solution) -> bool:
    """Whether some encoder's zero or scale, or an SU's place from some time on, is called wrong."""
    return any(fault.kind in _OF_PLACES for fault in solution.faults)


def differs_by_physics(
    solution: Solution, along: MotionEstimate, plain: MotionEstimate | None
) -> bool:
    """Whether what was found of encoders and loose SUs is rounding, the play of gears or a drift.

    An encoder that is wrong is off from place to place, and so are links that have play. What was
    wrong is gone once it is mended, and less is left; play stays. What encoders round off bends
    features by more than they tell: all samples are as likely without what it looks like. So do
    gears that yield: what was taken off for them alone comes back as slack. A bias that drifts
    looks like an SU that was turned, to features alone; play that stays says nothing of whether one
    was.

    Args:
        solution: the estimate, with its faults.
        along: the fit of its logs.
        plain: the fit of the logs in which nothing was mended; None where there is none.
    """
    kinds = {fault.kind for fault in solution.faults}
    if plain is None or not kinds & _OF_PLACES or not kinds <= {"contact", *_OF_PLACES}:
        return False
    if not (plain.misfit <= max(GOOD_FIT, along.misfit) and are_plausible(plain.state).all()):
        return False
    if "loose" not in kinds and 0 < plain.slack * _STAYS < along.slack:
        return True
    # Slack and other causes would explain what is wrong as well.
    as_stiff = plain.slack <= along.slack and set(plain.causes) <= set(along.causes)
    needs_more = set(plain.causes) < set(along.causes)
    return as_stiff and (needs_more or gained(plain, along) <= _worth(solution, along))


def _worth(solution: Solution, along: MotionEstimate) -> float:
    """Logarithm of the likelihood that what was found of encoders and loose SUs has to gain.

    Each of its parameters costs half the logarithm of the number of measurements (Schwarz 1978).
    """
    parameters = sum(
        N_PLACEMENT if fault.kind == "loose" else 1
        for fault in solution.faults
        if fault.kind in _OF_PLACES
    )
    measured = sum(
        3 * log.independence * float(p.measured.sum())
        for log, p in zip(along.problem.logs, along.fitted.predicted, strict=True)
    )
    return max(CERTAIN, 0.5 * parameters * float(np.log(max(measured, 1.0))))


def gained(plain: MotionEstimate, along: MotionEstimate) -> float:
    """Logarithm of the likelihood that another fit gains, of the readings that both compare.

    Where mended logs leave readings out, as those while an encoder jumps, what is in one fit alone
    tells nothing of the other. An SU that came loose counts from then on.

    Args:
        plain: a fit.
        along: the other one, in whose noise the gain is.
    """
    names = plain.problem.tree.su_names, along.problem.tree.su_names
    _, here, there = np.intersect1d(*names, return_indices=True)
    mended = {log.log: h for h, log in enumerate(along.problem.logs)}
    gain = 0.0
    for g, log in enumerate(plain.problem.logs):
        if log.log not in mended:
            continue
        h = mended[log.log]
        other = along.problem.logs[h]
        _, i, j = np.intersect1d(log.time.round(6), other.time.round(6), return_indices=True)
        before, after = plain.fitted.predicted[g], along.fitted.predicted[h]
        both = before.measured[np.ix_(i, here)] & after.measured[np.ix_(j, there)]
        squares = before.residual[np.ix_(i, here)] ** 2 - after.residual[np.ix_(j, there)] ** 2
        weights = along.fitted.weights[h][np.ix_(j, there)][..., :3]
        gain += 0.5 * float((weights * squares)[both].sum())
    return gain


def stands_out(
    along: MotionEstimate,
    sampled: Sequence[Sampled],
    g: int,
    begin: float,
    end: float,
    *,
    pushed: str | None = None,
) -> bool:
    """Whether what a fit leaves in some time is more than noise and play, in any SU.

    A joint that was pushed moves the SUs beyond it by more than any other: what an SU on a base
    that gives way feels alone came from elsewhere.

    Args:
        along: the fit.
        sampled: its logs.
        g: number of the log.
        begin: of the time [s], and
        end: its end; a time that is not known stands out.
        pushed: the joint whose SUs count; by default all do.
    """
    log, fitted = along.problem.logs[g], along.fitted
    if not (np.isfinite(begin) and np.isfinite(end)):
        return True
    time = log.time + sampled[g].motion.grid.start
    during = (time >= begin) & (time <= end)
    if not during.any():
        return True
    seen = fitted.predicted[g].measured[during, :, None]
    noise = np.hypot(_usual(along, g)[during], _rattle(along, g)[:, None])
    ratio = np.where(seen, fitted.predicted[g].residual[during] / noise, 0.0)
    left = (ratio**2).mean(axis=(0, 2))
    tree = along.problem.tree
    if pushed in tree.joint_names:
        left = left[tree.activity()[:, tree.joint_names.index(pushed)]]
    return bool(left.max(initial=0.0) > _HIT**2)


def _usual(along: MotionEstimate, g: int) -> F64:
    """(K, U, 3) what is usually left of a log's samples [m/s^2].

    Readings that met what changes faster than they are taken tell too much of it, and are no hit;
    nor is what joints do between two positions that were read.
    """
    log, noise = along.problem.logs[g], along.fitted.noise[g][..., :3]
    also = log.between_positions @ (levers(along.problem.tree, along.state) ** 2).T
    if log.leaps is not None:
        also += log.leaps.readings
    return np.asarray(np.hypot(noise, np.sqrt(also)[..., None]))


def _rattle(along: MotionEstimate, g: int) -> F64:
    """(U,) what SUs feel of joints that cross their slack at once [m/s^2]; 0 where they have none.

    A joint goes from what its slack is in one place to what it is in another. A step that is
    low-passed as readings are has a largest acceleration, which joints that cross back and forth
    come near to for long; it counts over the levers of all joints.
    """
    log = along.problem.logs[g]
    step = np.convolve(log.taps, log.taps) * log.rate
    push = float(np.abs(np.diff(step) * log.rate).max())
    steps = np.maximum(np.sqrt(2) * along.slack, along.widest_slack[g])
    arm = np.sqrt(((levers(along.problem.tree, along.state) * steps) ** 2).sum(axis=1))
    return np.asarray(push * arm)


def _share_compared(trajectories: Sequence[Trajectory], sampled: Sequence[Sampled]) -> float:
    """Share of the moments that have samples to compare; 1 where nothing rests.

    Left out are those around poses that have none at all. A robot that rests once and then moves on
    and on has no samples in its only pose, and a thousand beyond.
    """
    compared, lost = 0, 0
    for log, s in zip(trajectories, sampled, strict=True):
        if not s.at_rest:
            continue
        there = np.asarray(log.valid.any(axis=1))
        compared += int(there.sum())
        for pose in s.neighbourhoods:
            ends = [np.searchsorted(log.kept, window) for window in pose.windows]
            around = np.concatenate([there[begin:end] for begin, end in ends])
            if not around.any():
                lost += around.size
    return compared / (compared + lost) if compared + lost else 1.0


def with_samples(found: Estimate, along: MotionEstimate) -> Estimate:
    """An estimate with the placements and sensors that all samples show.

    Where limbs are relative to each other shows in no more than what a base does that gives way.
    That is told to be open, and all begin at the base's origin.
    """
    T = np.array(along.state.T_parent_joint)
    first = np.unique(along.problem.between_limbs // N_JOINT)
    T[first, :3, 3] = found.state.T_parent_joint[first, :3, 3]
    return replace(found, state=replace(along.state, T_parent_joint=T))
