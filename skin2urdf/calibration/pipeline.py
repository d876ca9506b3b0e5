"""calibrate(): the way from logs to a calibrated robot, in one screen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.calibration.around_poses import judged_by_samples
from skin2urdf.calibration.beginning import Beginning, begin
from skin2urdf.calibration.clock import Clock, Progress, Tell
from skin2urdf.calibration.explanation import explain_readings
from skin2urdf.calibration.late import clocks_in_all, late_publishers, late_sus
from skin2urdf.calibration.refusal import check_fit, tell_what_streams_show
from skin2urdf.calibration.result import Calibration, Source, SuSource
from skin2urdf.calibration.rounds import Solution
from skin2urdf.calibration.samples import with_samples
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.errors import BadFitError, InsufficientDataError, UsageError
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.vertical import notes_on_vertical_joints
from skin2urdf.estimation.uncertainty.goodness import Goodness, goodness
from skin2urdf.estimation.uncertainty.health import health_notes
from skin2urdf.estimation.uncertainty.narrow import narrow_priors
from skin2urdf.estimation.uncertainty.observability import Observability, observability
from skin2urdf.faults import distinct, without_slips
from skin2urdf.model.canonical import canonical
from skin2urdf.notes import Note
from skin2urdf.recording.holding import joints_as_measured
from skin2urdf.recording.progress import Share
from skin2urdf.recording.records import Recording
from skin2urdf.signals.alike import joints_moved_alike
from skin2urdf.signals.filters import eroded, low_pass, noise_bandwidth
from skin2urdf.signals.publishers import all_that_are_off
from skin2urdf.signals.records import JointClock
from skin2urdf.signals.sampling import Sampled
from skin2urdf.structure.records import KinematicTree
from skin2urdf.structure.unknown_positions import unknown_position_notes


def calibrate(
    logs: str | Path | Recording | Sequence[str | Path | Recording],
    settings: CalibrationSettings | None = None,
    *,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate a robot from one or several logs.

    Args:
        logs: paths of logs (files or folders), or recordings already read; several logs
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
    clock = Clock(progress)
    recordings = clock.run("reading", lambda tell: recordings_of(logs, tell, settings.without))
    # Clocks, samples on grids, their features, the tree that these show, and a first estimate.
    begun = begin(recordings, settings, clock)
    by_the_paper = settings.method == "paper"
    # Physics of real robots, or what is wrong, and what all samples say of either.
    with tell_what_streams_show(begun.logs.sampled):
        solution, along = (_follow_the_paper if by_the_paper else explain_readings)(begun, clock)
    # Of features, so that each pose can be predicted from the others, and of all samples, which
    # know of more than a rigid robot.
    features, sampled = solution.features, solution.logs.sampled
    fit = clock.run(
        "goodness of fit",
        lambda _: judged_by_samples(goodness(solution.found), along, features, sampled),
    )
    if along is not None:
        solution = replace(solution, found=with_samples(solution.found, along))
    if not by_the_paper:
        with tell_what_streams_show(sampled):
            check_fit(solution.found, along)
    information = clock.run("all samples", lambda _: along.information) if along else None
    seen = clock.run("observability", lambda _: observability(solution.found, information))
    late = late_publishers(along, sampled)
    off = all_that_are_off(begun.publishers, late)
    return _calibration(recordings, solution, along, fit, seen, off, clock)


def _calibration(
    recordings: Sequence[Recording],
    solution: Solution,
    along: MotionEstimate | None,
    fit: Goodness,
    seen: Observability,
    publishers: tuple[tuple[JointClock, ...], ...],
    clock: Clock,
) -> Calibration:
    """All that is known, in one record."""
    found, features, sampled = solution.found, solution.features, solution.logs.sampled
    tree = found.tree
    streams = [replace(f, log=log) for log, s in enumerate(sampled) for f in s.faults]
    span = np.array([_range(sampled, name) for name in tree.joint_names]).reshape(-1, 3)
    narrow: list[str] = []
    if solution.logs.settings.method != "paper":  # which estimates no errors of sensors at all
        narrow = [f"{words}: give what their data sheet says" for words in narrow_priors(found)]
    return Calibration(
        model=canonical(found.state.model(tree)),
        estimate=found,
        along=along,
        observability=seen,
        goodness=fit,
        features=features,
        activity=solution.seen,
        limits=span[:, :2],
        velocity=span[:, 2],
        continuous=_endless(sampled, tree, span[:, 1] - span[:, 0]),
        sources=tuple(Source(r.source, r.digest, r.duration) for r in recordings),
        settings=solution.logs.settings,
        faults=distinct(without_slips((*streams, *solution.faults))),
        notes=tuple(
            dict.fromkeys(
                (
                    *(note for s in sampled for note in s.notes),
                    *tree.notes,
                    *_notes_on_alike_joints(tree, sampled),
                    *unknown_position_notes(features, tree),
                    *health_notes(found, fit),
                    *notes_on_vertical_joints(tree, found.state, along),
                    *narrow,
                )
            )
        ),
        seconds=clock.seconds,
        clocks=tuple(
            (*found_before, *others)
            for found_before, others in zip(
                clocks_in_all([s.clocks for s in sampled], along),
                late_sus(along, sampled, features),
                strict=True,
            )
        ),
        su_sources=su_sources(recordings, sampled),
        publishers=publishers,
    )


def _notes_on_alike_joints(tree: KinematicTree, sampled: Sequence[Sampled]) -> list[Note]:
    """Joints that the log does not tell from each other, where some of them carry SUs."""
    carry = {tree.joint_names[j] for su in tree.su_joint for j in tree.chain(int(su))}
    groups = joints_moved_alike([s.motion for s in sampled])
    return [Note("moved alike", joints=joints) for joints in groups if not carry.isdisjoint(joints)]


def su_sources(recordings: Sequence[Recording], sampled: Sequence[Sampled]) -> dict[str, SuSource]:
    """Where the readings of every SU come from; of several logs the longest counts.

    Args:
        recordings: the logs.
        sampled: what was taken from each.
    """
    found: dict[str, SuSource] = {}
    for recording, s in zip(recordings, sampled, strict=True):
        rate = s.motion.grid.rate
        taps, along = (low_pass(cutoff, rate) for cutoff in (s.cutoff, s.cutoff_along))
        once, twice = (noise_bandwidth(t, rate) for t in (taps, np.convolve(along, along)))
        for su in recording.sus:
            known = found.get(su.name)
            if su.time.size > 1 and (known is None or known.duration < recording.duration):
                often = 1.0 / float(np.median(np.diff(su.time)))
                found[su.name] = SuSource(su.topic, often, once, twice, recording.duration)
    return found


def _follow_the_paper(begun: Beginning, clock: Clock) -> tuple[Solution, None]:
    """The paper's own estimator (Algorithm 2), judged like any other estimate."""
    from skin2urdf.paper.method import PaperSettings, as_estimate, estimate_paper

    tree, features = begun.structure.certain_tree, begun.features
    gravity = begun.logs.settings.estimation.priors.gravity
    result = clock.run(
        "estimation", lambda _: estimate_paper(features, tree, PaperSettings(gravity=gravity))
    )
    if not result.converged:
        open_ = [f"{s.su} (e_T {s.e_total:.2f} g^2)" for s in result.steps if not s.converged]
        raise BadFitError(
            f"the paper's method did not reach its stop value for {', '.join(open_)}",
            "calibrate with the default method, or record more poses",
        )
    found = as_estimate(result, features, gravity)
    return Solution(begun.logs, begun.structure.seen, found, features), None


def recordings_of(
    logs: str | Path | Recording | Sequence[str | Path | Recording],
    tell: Tell,
    without: Sequence[str] = (),
) -> list[Recording]:
    """Read the logs that are not read yet; those made in memory are timed as files are.

    Args:
        logs: paths, or recordings.
        tell: told the share of the work that is done.
        without: names or topics of SUs that are left out, or patterns of these.

    Raises:
        UnreadableInputError: a log can not be read.
        UsageError: what is to be left out is in no log, or a log is given twice.
        InsufficientDataError: none is given.
    """
    from skin2urdf.recording.choosing import without_sus
    from skin2urdf.recording.reading import read
    from skin2urdf.recording.retiming import retimed

    given = [logs] if isinstance(logs, str | Path | Recording) else list(logs)
    out = []
    for i, log in enumerate(given):

        def part(share: Share, i: int = i) -> None:
            tell(share.among(i, len(given)))

        if not isinstance(log, Recording):
            out.append(read(log, progress=part))
        else:
            out.append(joints_as_measured(log) if log.digest else retimed(log))
    if not out:
        raise InsufficientDataError("no log was given", "name at least one log", lacks="logs")
    _check_that_none_is_another(out)
    return without_sus(out, without)


def _check_that_none_is_another(recordings: Sequence[Recording]) -> None:
    """Raise where a log is given twice: what is counted twice seems better known than it is."""
    sources: dict[str, str] = {}
    for recording in recordings:
        if recording.digest in sources:
            raise UsageError(
                f"{recording.source} holds the same bytes as {sources[recording.digest]}",
                "give each log once",
                recording.source,
            )
        if recording.digest:
            sources[recording.digest] = recording.source


def _endless(sampled: Sequence[Sampled], tree: KinematicTree, span: F64) -> Bool:
    """(D,) True for revolute joints that a log wraps, or that went further than any with stops."""
    columns = [s.motion.dof_names.index(name) for s in sampled[:1] for name in tree.joint_names]
    wraps = np.logical_or.reduce([s.motion.wraps[columns] for s in sampled])
    return np.asarray(~tree.prismatic & (wraps | (span > _LARGEST_SPAN)))


_LARGEST_SPAN = 4 * np.pi
"""Range of the joints of arms that have stops all the same: a turn either way [rad]."""


def _range(sampled: Sequence[Sampled], name: str) -> tuple[float, float, float]:
    """Lowest and highest measured position and highest speed of a joint over all logs."""
    motions = [(s.motion, s.motion.dof_names.index(name)) for s in sampled]
    motions = [(m, d) for m, d in motions if m.named[d]]
    q = np.concatenate([m.q[m.valid, d] for m, d in motions])
    clear = [eroded(m.valid, _DERIVED) for m, _ in motions]
    if not any(c.any() for c in clear):
        clear = [m.valid for m, _ in motions]
    speeds = [np.abs(m.qd[c, d]) for (m, d), c in zip(motions, clear, strict=True)]
    return float(q.min()), float(q.max()), float(np.concatenate(speeds).max())


_DERIVED = 25
"""Samples of the grid to either side that a velocity is made from."""
