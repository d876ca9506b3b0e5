"""What the SUs read along a log, beside what a calibration predicts that they read."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.errors import UsageError
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.priors import MotionPriors
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.records import Predicted
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.recording.reading import read
from skin2urdf.recording.records import Recording
from skin2urdf.signals.sampling import sampled_together
from skin2urdf.signals.trajectory import in_order, trajectory
from skin2urdf.structure.ordering import places_of
from skin2urdf.structure.records import KinematicTree

_SPANS = 750
"""Spans of time of which a trace keeps two samples each: a screen has about as many columns."""
_REACH = 5e-3
"""By how much clocks may still be off [s]; nothing is compared so near to a gap."""


@dataclass(frozen=True, eq=False)
class Trace(Record):
    """Low-passed readings of one SU along one log, and their prediction, thinned out to n samples.

    Attributes:
        log: number of the log.
        su: the SU.
        time: (n,) [s].
        reading: (n, 3) [m/s^2].
        predicted: (n, 3) [m/s^2].
        rms: root of the mean square of what is left, over all samples and axes [m/s^2].
    """

    log: int
    su: str
    time: F64
    reading: F64
    predicted: F64
    rms: float


def traces_of(along: MotionEstimate | None) -> tuple[Trace, ...]:
    """Traces of a fit of all samples that was just made; none where there is none."""
    if along is None:
        return ()
    problem, fitted = along.problem, along.fitted
    return tuple(
        trace
        for g, predicted in enumerate(fitted.predicted)
        for trace in _traces(problem, fitted.state, predicted, g, problem.logs[g].log)
    )


def replay(
    log: str | Path,
    document: Mapping[str, Any],
    progress: Callable[[float], None] | None = None,
) -> tuple[Recording, tuple[Trace, ...]]:
    """Read a log again and predict it from a calibration's JSON.

    Readings are as they were recorded: what the calibration mended is not mended here, and neither
    drifts of biases and scales, clocks that wander nor elastic joints are followed.

    Args:
        log: one of the logs that the calibration was made from.
        document: the JSON beside its URDF.
        progress: told the share of the log that is read.

    Returns:
        The log and its traces.

    Raises:
        UnreadableInputError: the log can not be read.
        UsageError: the calibration was not made from this log.
        InsufficientDataError: nothing in it can be compared.
    """
    recording = read(log, progress)
    g = _number_of(recording, document)
    sampled, su_names = sampled_together([recording])
    motion = sampled[0].motion
    tree = _tree(document, motion.dof_names, su_names)
    state = _state(document, tree, g)
    reach = float(np.abs(state.clock[:, :, 0]).max(initial=0.0)) + _REACH
    path = trajectory(sampled[0], 0, reach)
    dofs = places_of(tree.joint_names, motion.dof_names)
    path = in_order(path, dofs, places_of(tree.su_names, su_names))
    path = replace(path, rates=None, turning=None)  # traces are of accelerometers
    sensors = Priors(gravity=float(document["settings"]["estimation"]["priors"]["gravity"]))
    known = MotionPriors(
        sensors=sensors,
        gravity=0.0,
        front=np.zeros((2, 2)),
        lag=0.0,
        drift=0.0,
        bias_walk=0.0,
        unseen=np.zeros(0),
        curvature=1.0,  # as the document has it
    )
    problem = MotionProblem(tree, [path], known)
    return recording, tuple(_traces(problem, state, problem.predict(state, 0), 0, g))


def _number_of(recording: Recording, document: Mapping[str, Any]) -> int:
    """Which of a calibration's logs a recording is."""
    digests = [source["digest"] for source in document["inputs"]]
    if recording.digest not in digests:
        paths = ", ".join(str(source["path"]) for source in document["inputs"])
        raise UsageError(
            f"{recording.source}: the calibration was not made from this log",
            f"give one of its own ({paths}), whose direction of gravity is known",
        )
    return digests.index(recording.digest)


def _tree(document: Mapping[str, Any], dofs: Sequence[str], sus: Sequence[str]) -> KinematicTree:
    """The tree of a calibration, with those of its SUs that a log holds.

    Raises:
        UsageError: the log lacks a joint of it.
    """
    joints = document["tree"]["joints"]
    names = [joint["name"] for joint in joints]
    missing = [name for name in names if name not in dofs]
    if missing:
        raise UsageError(
            f"the log does not hold joint {missing[0]}", "give the log that holds all joints"
        )
    index = {None: -1} | {name: j for j, name in enumerate(names)}
    kept = {name: index[joint] for name, joint in document["tree"]["sus"].items() if name in sus}
    return KinematicTree(
        tuple(names),
        np.array([index[joint["parent"]] for joint in joints], dtype=np.int64),
        tuple(joint["type"] for joint in joints),
        tuple(kept),
        np.array(list(kept.values()), dtype=np.int64),
    )


def _state(document: Mapping[str, Any], tree: KinematicTree, g: int) -> MotionState:
    """What a calibration's JSON says of log g."""
    joints = [document["joints"][name] for name in tree.joint_names]
    sus = [document["sus"][name] for name in tree.su_names]
    samples = document["samples"]
    front, clock = np.zeros((tree.n_sus, 2)), np.zeros((1, tree.n_sus, 2))
    curvature = np.zeros((tree.n_sus, 3))
    gravity = float(document["settings"]["estimation"]["priors"]["gravity"])
    clock[0, :, 0] = [su["latency"] or 0.0 for su in sus]
    if samples is not None:
        gravity = float(samples["gravity"])
        parts = [samples["sus"][name] for name in tree.su_names]
        front = np.array([part["front_end"] for part in parts], dtype=np.float64)
        clock[0, :, 0] = [part["lag"][g] for part in parts]
        clock[0, :, 1] = [part["clock_drift"][g] for part in parts]
        # Documents of earlier versions know no curved axes.
        straight = [0.0] * 3
        curvature = np.array([part.get("curvature", straight) for part in parts], dtype=np.float64)
    placements = State(
        T_parent_joint=np.array([j["T_parent_joint"] for j in joints]).reshape(-1, 4, 4),
        T_joint_su=np.array([su["T_joint_su"] for su in sus]).reshape(-1, 4, 4),
        up=np.array(document["gravity_up"], dtype=np.float64)[[g]],
        bias=np.array([su["bias"] for su in sus]),
        shape=np.array([[*su["scale"], *su["cross_yz_xz_xy"]] for su in sus]),
    )
    return MotionState(
        placements=placements,
        gravity=gravity,
        front=front,
        clock=clock,
        knots=(np.zeros((0, tree.n_sus, 3)),),
        unseen=np.zeros(0),
        curvature=curvature,
    )


def _traces(
    problem: MotionProblem, state: MotionState, predicted: Predicted, g: int, log: int
) -> list[Trace]:
    """Traces of all SUs along the problem's log g, which is called ``log``."""
    path = problem.logs[g]
    at = problem.read_at(state, g)
    found = []
    for u, name in enumerate(problem.tree.su_names):
        whole = np.flatnonzero(predicted.measured[:, u])
        if not len(whole):
            continue
        reading = path.splines[u].at(at[:, u])[whole]
        left = predicted.residual[whole, u]
        kept = _telling(path.time[whole], reading, left)
        rms = float(np.sqrt(np.mean(left**2)))
        read_ = reading[kept]
        found.append(Trace(log, name, path.time[whole][kept], read_, read_ - left[kept], rms))
    return found


def _telling(time: F64, reading: F64, left: F64) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Indices of the samples that stand out most in every span of time.

    Those are the one that fits worst, and the one that is farthest from the span's mean: what a
    line through all samples would show at this width.
    """
    spans = ((time - time[0]) / max(float(time[-1] - time[0]), 1e-9) * _SPANS).astype(np.int64)
    starts = np.flatnonzero(np.diff(spans, prepend=-1))
    counts = np.diff([*starts, len(time)])
    means = np.add.reduceat(reading, starts) / counts[:, None]
    away = np.linalg.norm(reading - np.repeat(means, counts, axis=0), axis=1)
    wrong = np.linalg.norm(left, axis=1)
    kept = []
    for size in (away, wrong):
        order = np.lexsort((size, spans))
        kept.append(order[np.append(starts[1:], len(time)) - 1])
    return np.unique(np.concatenate(kept))
