"""calibrate(): the way from logs to a calibrated robot, in one screen."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.calibration import BAD_FIT, GOOD_FIT, Calibration, CalibrationSettings, Source
from skin2urdf.errors import BadFitError, InsufficientDataError, StructureError
from skin2urdf.estimation.estimate import Estimate, estimate
from skin2urdf.estimation.health import health_notes, mirrored_sus, unlike_the_rest
from skin2urdf.estimation.observability import observability
from skin2urdf.estimation.order import ordered
from skin2urdf.model.dh import canonical
from skin2urdf.model.specific_force import beyond_first_order
from skin2urdf.recording.records import Recording
from skin2urdf.signals.features import Curvature, Sampled, extract_features, sample_recording
from skin2urdf.signals.records import Features
from skin2urdf.structure.activity import activity
from skin2urdf.structure.records import KinematicTree
from skin2urdf.structure.tree import kinematic_tree

T = TypeVar("T")
Progress = Callable[[str, float], None]
"""Called with the name of a stage and the share of it that is done, in [0, 1]."""


def calibrate(
    logs: str | Path | Recording | Sequence[str | Path | Recording],
    settings: CalibrationSettings | None = None,
    *,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate a robot from one or several logs.

    Args:
        logs: paths of ROS 2 MCAP logs (or bag folders), or recordings already read; several logs
            are of one robot, each with its own orientation of the base.
        settings: choices; the defaults suit robots with MEMS accelerometers.
        progress: told how far each stage is.

    Returns:
        The calibrated robot with everything known about how good it is.

    Raises:
        UnreadableInputError: a log can not be read.
        InsufficientDataError: the logs lack what a calibration needs.
        StructureError: the SUs' activity contradicts every kinematic tree.
        BadFitError: no model explains the readings.
    """
    settings = settings or CalibrationSettings()
    clock = _Clock(progress or (lambda _stage, _share: None))
    recordings = clock.run("reading", lambda tell: _recordings(logs, tell))
    sampled, su_names = clock.run("sampling", lambda _: _sampled(recordings))
    features = clock.run("features", lambda _: extract_features(sampled, su_names))
    seen = activity(features, settings.static_threshold)
    tree = ordered(kinematic_tree(seen, features), features)
    mirrored: list[str] = []
    if settings.method == "paper":
        found = clock.run("estimation", lambda _: _by_the_paper(features, tree, settings))
    else:
        found, features, tree = _settled(clock, sampled, su_names, tree, features, settings)
        mirrored = [tree.su_names[u] for u in mirrored_sus(found)]
        if mirrored:
            sampled = [_negated(s, [su_names.index(n) for n in mirrored]) for s in sampled]
            features = clock.run("features", lambda _: extract_features(sampled, su_names))
            found, features = _relinearised(clock, sampled, su_names, tree, features, settings)
        if not found.cost_per_dof <= BAD_FIT:
            raise BadFitError(*_why_bad(found), cost_per_dof=found.cost_per_dof)
    span = np.array([_range(sampled, name) for name in tree.joint_names]).reshape(-1, 3)
    return Calibration(
        model=canonical(found.state.model(tree)),
        estimate=found,
        observability=clock.run("observability", lambda _: observability(found)),
        features=features,
        activity=seen,
        limits=span[:, :2],
        velocity=span[:, 2],
        sources=tuple(Source(r.source, r.digest, r.duration) for r in recordings),
        settings=settings,
        notes=tuple(
            dict.fromkeys(
                (*features.notes, *tree.notes, *_mirror_notes(mirrored), *health_notes(found))
            )
        ),
        seconds=clock.seconds,
    )


def _settled(
    clock: _Clock,
    sampled: Sequence[Sampled],
    su_names: Sequence[str],
    tree: KinematicTree,
    features: Features,
    settings: CalibrationSettings,
) -> tuple[Estimate, Features, KinematicTree]:
    """Estimate, and look at the structure again where the model does not explain the data.

    Features that were taken with a model's prediction are free of most second-order effects, so
    that they show the activity of DoFs that moved together more clearly than the first ones.
    """
    best, refined = _relinearised(clock, sampled, su_names, tree, features, settings)
    latest, shown, tried = best, refined, [tree]
    for _ in range(2):
        felt = set(latest.tree.joint_names)
        seen = activity(shown, settings.static_threshold)
        deaf = [n for n, e in zip(seen.dof_names, seen.excited, strict=True) if e and n not in felt]
        if latest.cost_per_dof <= GOOD_FIT and not deaf and not unlike_the_rest(latest):
            break
        try:
            again = ordered(kinematic_tree(seen.felt_somewhere(deaf), shown), shown)
        except StructureError:
            break
        if any(_alike(again, other) for other in tried):
            break
        tried.append(again)
        latest, shown = _relinearised(clock, sampled, su_names, again, features, settings)
        if latest.cost_per_dof < 0.8 * best.cost_per_dof:
            best, refined = latest, shown
    return best, refined, best.tree


def _alike(a: KinematicTree, b: KinematicTree) -> bool:
    """Whether two trees have the same joints before the same SUs, in the same order."""

    def chains(tree: KinematicTree) -> dict[str, list[str]]:
        return {
            name: [tree.joint_names[j] for j in tree.chain(int(joint))]
            for name, joint in zip(tree.su_names, tree.su_joint, strict=True)
        }

    return chains(a) == chains(b)


def _relinearised(
    clock: _Clock,
    sampled: Sequence[Sampled],
    su_names: Sequence[str],
    tree: KinematicTree,
    features: Features,
    settings: CalibrationSettings,
) -> tuple[Estimate, Features]:
    """Estimate, take the features again with what the estimate predicts, until it settles."""
    found = clock.run("estimation", lambda _: estimate(features, tree, settings.estimation))
    for _ in range(settings.relinearisations):
        previous, predicted, latency = found, _curvature(found, features), features.latency
        features = clock.run(
            "features",
            lambda _, c=predicted, t=latency: extract_features(  # type: ignore[misc]
                sampled, su_names, curvature=c, latency=t
            ),
        )
        found = clock.run(
            "estimation",
            lambda _, f=features, e=previous: estimate(  # type: ignore[misc]
                f, tree, settings.estimation, start=e.state
            ),
        )
        gain = previous.cost_per_dof / max(found.cost_per_dof, 1e-12)
        settled = gain < 1.02 and found.cost_per_dof < GOOD_FIT
        hopeless = gain < 2.0 and found.cost_per_dof > BAD_FIT
        if _moved(previous, found) < 1e-4 or settled or hopeless:
            break
    return found, features


def _negated(sampled: Sampled, sus: Sequence[int]) -> Sampled:
    """A log with the readings of some SUs negated."""
    readings = np.array(sampled.readings)
    readings[:, list(sus)] *= -1
    return replace(sampled, readings=readings)


def _mirror_notes(names: Sequence[str]) -> list[str]:
    return [
        f"{name} reports negated readings or a left-handed frame, unlike the other SUs; it was "
        "calibrated on the negated readings: mind that when you use its frame"
        for name in names
    ]


def _by_the_paper(
    features: Features, tree: KinematicTree, settings: CalibrationSettings
) -> Estimate:
    """The paper's own estimator (Algorithm 2), judged like any other estimate."""
    from skin2urdf.estimation.paper_method import PaperSettings, as_estimate, estimate_paper

    gravity = settings.estimation.priors.gravity
    result = estimate_paper(features, tree, PaperSettings(gravity=gravity))
    if not result.converged:
        open_ = [f"{s.su} (e_T {s.e_total:.2f} g^2)" for s in result.steps if not s.converged]
        raise BadFitError(
            f"the paper's method did not reach its stop value for {', '.join(open_)}",
            "calibrate with the default method, or record more poses",
        )
    return as_estimate(result, features, gravity)


class _Clock:
    """Runs stages, tells progress and keeps their times."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self.seconds: dict[str, float] = {}

    def run(self, stage: str, work: Callable[[Callable[[float], None]], T]) -> T:
        """Run one stage; its time is added to earlier runs of the same name."""
        begin = time.perf_counter()
        self._progress(stage, 0.0)
        result = work(lambda share: self._progress(stage, share))
        self._progress(stage, 1.0)
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - begin
        return result


def _recordings(
    logs: str | Path | Recording | Sequence[str | Path | Recording], tell: Callable[[float], None]
) -> list[Recording]:
    from skin2urdf.recording.reading import read

    given = [logs] if isinstance(logs, str | Path | Recording) else list(logs)
    out = []
    for i, log in enumerate(given):

        def part(share: float, i: int = i) -> None:
            tell((i + share) / len(given))

        out.append(log if isinstance(log, Recording) else read(log, progress=part))
    if not out:
        raise InsufficientDataError("no log was given", "name at least one log")
    return out


def _sampled(recordings: Sequence[Recording]) -> tuple[list[Sampled], tuple[str, ...]]:
    """All logs on their grids, with the names of every DoF and SU that occurs in any of them."""
    dof_names = tuple(sorted({j.name for r in recordings for j in r.joints}))
    su_names = tuple(sorted({s.name for r in recordings for s in r.sus}))
    if not su_names or not dof_names:
        what = "accelerometer readings" if dof_names else "joint positions"
        raise InsufficientDataError(
            f"{', '.join(r.source or 'the recording' for r in recordings)}: no {what}",
            "record the joint states and the SUs' topics together in one log",
        )
    return [sample_recording(r, dof_names, su_names) for r in recordings], su_names


def _curvature(found: Estimate, features: Features) -> Curvature:
    """Predicts, from an estimate, what readings hold beyond first order around a pose."""
    tree, state = found.tree, found.state
    dof = [features.dof_names.index(n) for n in tree.joint_names]
    su = [features.su_names.index(n) for n in tree.su_names]
    model, M = state.model(tree), state.sensor_matrix()
    gravity = found.cost.priors.gravity

    def predict(q: F64, dq: F64, qd: F64, qdd: F64, log: int) -> F64:
        beyond = beyond_first_order(
            model, q[dof], dq[:, dof], qd[:, dof], qdd[:, dof], state.up[log] * gravity
        )
        out = np.zeros((len(dq), features.n_sus, 3))
        out[:, su] = np.einsum("nui,uji->nuj", beyond, M)
        return out

    return predict


def _moved(a: Estimate, b: Estimate) -> float:
    """Largest change of any placement between two estimates [m, and entries of rotations]."""
    joints = np.abs(a.state.T_parent_joint - b.state.T_parent_joint).max(initial=0.0)
    return float(max(joints, np.abs(a.state.T_joint_su - b.state.T_joint_su).max(initial=0.0)))


def _range(sampled: Sequence[Sampled], name: str) -> tuple[float, float, float]:
    """Lowest and highest position and highest speed of a joint over all logs."""
    columns = [s.motion.dof_names.index(name) for s in sampled]
    q = np.concatenate([s.motion.q[:, d] for s, d in zip(sampled, columns, strict=True)])
    speeds = [np.abs(s.motion.qd[:, d]).max() for s, d in zip(sampled, columns, strict=True)]
    speed = float(max(speeds))
    return float(q.min()), float(q.max()), speed


def _why_bad(found: Estimate) -> tuple[str, str]:
    """What a bad fit looks like, by SU and pose, and what to do about it."""
    per = found.chi2_by_block.sum(axis=0) / np.maximum(found.count.sum(axis=0), 1)
    worst = np.argsort(-per)[:3]
    named = ", ".join(f"{found.tree.su_names[u]} ({per[u]:.0f})" for u in worst)
    what = (
        f"no robot of {found.tree.n_joints} joints explains the readings: cost per degree of "
        f"freedom {found.cost_per_dof:.0f} where 1 is expected; worst SUs (theirs): {named}"
    )
    if all(per[u] > BAD_FIT for u in range(len(per)) if found.tree.su_joint[u] >= 0):
        where = (
            "all SUs are affected: check that the base stands still and that the joint states are "
            "the measured ones, in rad"
        )
    else:
        where = "check that these SUs are fixed rigidly and report m/s^2 in a right-handed frame"
    return what, f"{where}; `skin2urdf explore` shows the structure that was found"
