"""calibrate_with_model(): the way from logs and a given model to SUs on it, in one screen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from skin2urdf.arrays import Int
from skin2urdf.calibration.clock import Clock, Progress
from skin2urdf.calibration.late import clocks_in_all, late_publishers
from skin2urdf.calibration.pipeline import recordings_of, su_sources
from skin2urdf.calibration.result import Source
from skin2urdf.calibration.rounds import Logs, sample_logs
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.errors import InsufficientDataError
from skin2urdf.faults import Fault, distinct
from skin2urdf.hypotheses.corrected import Corrected, evident_errors
from skin2urdf.recording.records import Recording
from skin2urdf.signals.encoders import corrected
from skin2urdf.signals.publishers import all_that_are_off
from skin2urdf.signals.sampling import Sampled
from skin2urdf.signals.trajectory import ENOUGH_MOTION, Trajectory, trajectory
from skin2urdf.vendor.description import describe
from skin2urdf.vendor.explaining import explain
from skin2urdf.vendor.fitting import REACH, Bench
from skin2urdf.vendor.inertials import inertials
from skin2urdf.vendor.matching import Chassis, match
from skin2urdf.vendor.placing import place_sus
from skin2urdf.vendor.records import Correction, ModelCalibration
from skin2urdf.vendor.source import ModelText, read_model
from skin2urdf.vendor.words import model_notes


def calibrate_with_model(
    logs: str | Path | Recording | Sequence[str | Path | Recording],
    model: str | Path | ModelText,
    settings: CalibrationSettings | None = None,
    correction: Correction | None = None,
    *,
    progress: Progress | None = None,
) -> ModelCalibration:
    """Find SUs on a given model, and where the robot differs from it.

    Args:
        logs: paths of logs, or recordings already read, of one robot; any motion does.
        model: a URDF or xacro file, ``bag`` for the description in a log, or its text.
        settings: choices of the estimation.
        correction: what of the model may be corrected; nothing by default.
        progress: told how far each stage is.

    Returns:
        The SUs in the frames of the model's links, with all that is known about how good it is.

    Raises:
        UnreadableInputError: a log or the model can not be read.
        InsufficientDataError: the logs lack what it takes.
        ModelMismatchError: the model is not the robot in the logs.
    """
    settings, correction = settings or CalibrationSettings(), correction or Correction()
    clock = Clock(progress)
    recordings = clock.run("reading", lambda tell: recordings_of(logs, tell, settings.without))
    given = model if isinstance(model, ModelText) else read_model(model, _paths(recordings))
    description = describe(given)
    leaps = clock.run("leaps", lambda _: evident_errors(recordings))
    mended = corrected(recordings, [leap.error for leap in leaps])
    sampled = sample_logs(mended, settings, clock)
    chassis = match(description, sampled.sampled[0].motion.dof_names)
    heard = _heard(sampled)
    trajectories = _trajectories(sampled, chassis, heard)
    names = tuple(sampled.su_names[u] for u in heard)
    bench = Bench(chassis, trajectories, names, settings, inertials(chassis))
    sensors = settings.estimation.priors
    placed = clock.run("segments", lambda tell: place_sus(chassis, trajectories, sensors, tell))
    found = clock.run("all samples", lambda tell: explain(bench, placed, correction, tell))
    seen = clock.run("observability", lambda _: found.bench.judged(found.along, sensors))
    streams = [replace(f, log=log) for log, s in enumerate(sampled.sampled) for f in s.faults]
    result = ModelCalibration(
        chassis=chassis,
        correction=correction,
        blueprint=found.blueprint,
        along=found.along,
        left=found.left,
        observability=seen,
        instead=found.placed.instead,
        offsets=found.offsets,
        sources=tuple(Source(r.source, r.digest, r.duration) for r in recordings),
        settings=settings,
        odd=found.odd,
        faults=distinct((*streams, *map(_jump, leaps))),
        left_out=tuple(name for name in sampled.su_names if name not in bench.su_names),
        notes=tuple(dict.fromkeys(note for s in sampled.sampled for note in s.notes)),
        seconds=clock.seconds,
        clocks=clocks_in_all([s.clocks for s in sampled.sampled], found.along),
        su_sources=su_sources(recordings, sampled.sampled),
        publishers=all_that_are_off(
            [()] * len(recordings), late_publishers(found.along, sampled.sampled)
        ),
    )
    return replace(result, notes=(*model_notes(result, sampled.sampled), *result.notes))


def _jump(leap: Corrected) -> Fault:
    """An encoder that jumped."""
    error = leap.error
    return Fault(
        "encoder jump", error.dof, log=error.log, begin=error.begin, size=error.size, unit="rad"
    )


def _paths(recordings: Sequence[Recording]) -> list[str]:
    return [recording.source for recording in recordings if recording.source]


def _whole(log: Trajectory, sampled: Sampled) -> bool:
    """Whether some SU has samples to compare along most of a log, or in most of its rests."""
    compared = np.asarray(log.valid.any(axis=1))
    if 2 * compared.sum() > compared.size:
        return True
    there = log.kept[compared]
    ends = np.searchsorted(there, [(rest.begin, rest.end) for rest in sampled.rests])
    return bool(len(there) and 2 * (ends[:, 1] > ends[:, 0]).sum() >= len(ends))


def _heard(logs: Logs) -> Int:
    """Indices of the SUs that have valid samples in some log.

    Raises:
        InsufficientDataError: there is none.
    """
    heard = np.flatnonzero(np.any([s.valid.any(axis=0) for s in logs.sampled], axis=0))
    if not len(heard):
        raise InsufficientDataError(
            "no SU has usable readings",
            "see what the topics publish with `skin2urdf info`, then record again",
        )
    return heard


def _trajectories(logs: Logs, chassis: Chassis, heard: Int) -> list[Trajectory]:
    """The logs in the order of the model's joints.

    Raises:
        InsufficientDataError: nothing is whole for long enough.
    """
    found = [chassis.along(trajectory(s, g, REACH), heard) for g, s in enumerate(logs.sampled)]
    whole = any(_whole(log, s) for log, s in zip(found, logs.sampled, strict=True))
    if not (whole or sum(log.in_motion for log in found) >= ENOUGH_MOTION):
        raise InsufficientDataError(
            "the log has no samples to compare along most of it, nor in most of its rests: it was "
            "recorded rest by rest, or has gaps everywhere",
            "record ten seconds or more of motion in all, in runs of several seconds each",
        )
    return found
