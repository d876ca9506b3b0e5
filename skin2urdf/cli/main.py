"""The command line: arguments in, text or JSON out, and an exit status that can be relied on."""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skin2urdf.cli.options import parser
from skin2urdf.cli.terminal import open_streams, progress_bar, silence_stdout
from skin2urdf.errors import Skin2UrdfError, UsageError
from skin2urdf.files import check_target, write_atomically
from skin2urdf.geometry.units import GRAVITY, MILLI_G
from skin2urdf.recording.naming import printable

if TYPE_CHECKING:
    from skin2urdf.calibration.settings import CalibrationSettings
    from skin2urdf.simulation import SimulationSettings

_INTERRUPTED = 130
_TO_REPAIR = 3
"""The URDF was written, but an SU or an encoder has to be set right before it fits the robot."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        arguments: words after the program's name; those of the process by default.

    Returns:
        Exit status: 0 all is well; 1 no trustworthy result can be given, or trees differ, or an
        internal error; 2 bad usage or unreadable input; 130 interrupted.
    """
    open_streams()
    _tolerant_output()
    _one_thread()
    options = parser(_robot_names).parse_args(arguments)
    if not options.debug:
        # The quality of a result is told in words; stray warnings of libraries only puzzle.
        warnings.simplefilter("ignore")
    try:
        status = _COMMANDS[options.command](options)
        sys.stdout.flush()
    except BrokenPipeError:
        silence_stdout()
        return 0
    except Skin2UrdfError as error:
        if options.debug:
            raise
        print(f"error: {printable(str(error))}", file=sys.stderr)
        if error.remedy:
            print(f"  -> {printable(error.remedy)}", file=sys.stderr)
        return error.exit_status
    except OSError as error:
        if options.debug:
            raise
        silence_stdout()
        where = f"{error.filename}: " if error.filename else "the output can not be written: "
        print(f"error: {where}{error.strerror or error}", file=sys.stderr)
        print("  -> check the paths, and that there is space where they lead", file=sys.stderr)
        return UsageError.exit_status
    except KeyboardInterrupt:
        print("interrupted; no file was left half-written", file=sys.stderr)
        return _INTERRUPTED
    except Exception as error:
        if options.debug:
            raise
        print(f"internal error: {type(error).__name__}: {error}", file=sys.stderr)
        print("  -> this is a defect; add --debug to see where, and report it", file=sys.stderr)
        return 1
    return status


def _calibrate(options: argparse.Namespace) -> int:
    """Logs to URDF and JSON."""
    begin = time.perf_counter()
    _refuse_to_overwrite(options.logs, options.output, Path(options.output).with_suffix(".json"))
    settings = calibration_settings(options)
    from skin2urdf.output import output_paths, save

    output_paths(options.output)
    from skin2urdf.calibration.pipeline import calibrate
    from skin2urdf.report.document import as_document
    from skin2urdf.report.summary import as_text

    with progress_bar(options.quiet) as bar:
        calibration = calibrate(options.logs, settings, progress=bar)
        bar("writing", 0.0)
        urdf, beside = save(
            calibration, options.output, name=options.name, visuals=not options.no_visuals
        )
    if options.json:
        _print_json(as_document(calibration))
    elif not options.quiet:
        print(as_text(calibration))
        print(f"wrote {_shown(urdf)} and {_shown(beside)} in {time.perf_counter() - begin:.1f} s")
    # Only the paper's method gets here with a bad fit: it was asked for, but is not to be trusted.
    if calibration.quality == "bad":
        return 1
    return _TO_REPAIR if any(fault.to_repair for fault in calibration.faults) else 0


def calibration_settings(options: argparse.Namespace) -> CalibrationSettings:
    """Settings as the options say."""
    least = {"bias": 0.0, "scale": 0.0, "cross": 0.0, "gravity": 1.0}
    given = {name: getattr(options, name) for name in least if getattr(options, name) is not None}
    for name in given:
        _at_least(options, name, least[name])
    _at_least(options, "threshold", 1e-3)
    if "bias" in given:
        given["bias"] *= MILLI_G
    from skin2urdf.geometry.earth import ANOMALY, normal_gravity

    if options.site is not None:
        latitude, height = options.site
        given["gravity"] = normal_gravity(math.radians(latitude), height)
    from skin2urdf.calibration.settings import CalibrationSettings
    from skin2urdf.estimation.problem.cost import Priors
    from skin2urdf.estimation.solve.estimate import EstimationSettings

    settings = CalibrationSettings(
        method=options.method,
        estimation=EstimationSettings(
            priors=replace(Priors(), **given),
            intrinsics=not options.no_intrinsics,
            refine=options.refine,
        ),
        static_threshold=options.threshold * GRAVITY,
        motion=options.motion,
        bandwidth=options.bandwidth,
    )
    return replace(settings, gravity_deviation=ANOMALY) if "gravity" in given else settings


def _robot_names() -> tuple[str, ...]:
    from skin2urdf.simulation import robot_names

    return robot_names()


def _simulate(options: argparse.Namespace) -> int:
    """A robot to a log and its truth."""
    from skin2urdf.recording.writing import write
    from skin2urdf.simulation import load_robot, robot_names, simulate

    if options.list:
        robots = [load_robot(name) for name in robot_names()]
        width = max(len(robot.name) for robot in robots)
        print("\n".join(f"{robot.name:{width}}  {robot.description}" for robot in robots))
        return 0
    if not (options.robot and options.output):
        raise UsageError(
            "a simulation needs a robot and a log to write",
            "skin2urdf simulate panda -o log.mcap (names: skin2urdf simulate --list)",
        )
    settings = _simulation_settings(options)
    robot = load_robot(options.robot)
    targets = [check_target(path) for path in (options.output, options.truth) if path]
    if len(set(targets)) < len(targets):
        raise UsageError("the log and the truth would be the same file", "give two names")
    _refuse_to_overwrite([robot.urdf, options.robot], *targets)
    with progress_bar(options.quiet) as bar:
        bar("moving the robot", 0.0)
        simulation = simulate(robot, settings)
        bar("moving the robot", 1.0)
        bar("writing the log", 0.0)
        write(
            simulation.recording,
            targets[0],
            compression=options.compression,
            chunked=not options.no_chunks,
            indexed=not options.no_index,
            joint_order=simulation.joint_order,
        )
    if options.truth:
        write_atomically(options.truth, simulation.truth.urdf)
    if not options.quiet:
        recording = simulation.recording
        messages = sum(len(su.time) for su in recording.sus) + len(recording.joints[0].time)
        print(
            f"{robot.name}: {len(recording.joints)} joints, {len(recording.sus)} SUs, "
            f"{len(simulation.truth.poses)} poses in {recording.duration:.0f} s, "
            f"{messages} messages"
        )
        print(f"wrote {' and '.join(map(_shown, targets))}")
    return 0


def _simulation_settings(options: argparse.Namespace) -> SimulationSettings:
    """Settings as the options say."""
    from math import radians

    from skin2urdf.simulation import SimulationSettings

    rpy = options.base_rpy
    return SimulationSettings(
        n_poses=options.poses,
        excite=options.excite,
        minutes=options.minutes,
        structural=options.structural,
        upright=options.upright,
        base_rpy=None if rpy is None else (radians(rpy[0]), radians(rpy[1]), radians(rpy[2])),
        seed=options.seed,
        grade=options.grade,
        tracking=options.tracking,
        imu_rate=options.imu_rate,
        joint_rate=options.joint_rate,
        encoder_bits=options.encoder_bits or None,
        jitter=options.jitter * 1e-3,
        lag=options.lag * 1e-3,
        sus_per_segment=options.sus_per_segment,
        sus_on_base=options.sus_on_base,
    )


def _compare(options: argparse.Namespace) -> int:
    """An estimated URDF against the true one."""
    _at_least(options, "seed", 0)
    import numpy as np

    from skin2urdf.output import document_beside
    from skin2urdf.report.comparison import as_text
    from skin2urdf.urdf.compare import compare, load_determined, load_open, load_unobservable

    beside = document_beside(options.estimate)
    comparison = compare(
        options.estimate,
        options.truth,
        unobservable=load_unobservable(beside) if beside else None,
        anchors=load_determined(beside) if beside else None,
        open_directions=load_open(beside) if beside else (),
        align=options.align,
        n_configurations=options.configurations,
        rng=np.random.default_rng(options.seed),
    )
    if options.json:
        _print_json(comparison.to_dict())
    elif not options.quiet:
        print(as_text(comparison), end="")
        if beside is None:
            print(
                f"note: no JSON of this very file beside {options.estimate}: what the log could "
                "not tell counts as error",
                file=sys.stderr,
            )
    return 0 if comparison.tree_equal else 1


def _explore(options: argparse.Namespace) -> int:
    """Activity matrix, tree and limbs."""
    _at_least(options, "threshold", 1e-3)
    if options.plot:
        check_target(options.plot)
    from skin2urdf.report.exploration import as_document, as_text
    from skin2urdf.survey import explore

    with progress_bar(options.quiet) as bar:
        explored = explore(options.logs, options.threshold * GRAVITY, progress=bar)
    if options.json:
        _print_json(as_document(explored))
    elif not options.quiet:
        print(as_text(explored), end="")
    if options.plot:
        from skin2urdf.report.figures import draw_exploration

        draw_exploration(explored.exploration, options.plot)
    if explored.contradiction is not None:
        raise explored.contradiction
    return 0


def _info(options: argparse.Namespace) -> int:
    """What a log holds and what it lacks."""
    from skin2urdf.report.inventory import as_document, as_text
    from skin2urdf.survey import survey

    with progress_bar(options.quiet) as bar:
        surveyed = survey(options.log, progress=bar)
    if options.json:
        _print_json(as_document(surveyed))
    elif not options.quiet:
        print(as_text(surveyed), end="")
    return 0


_COMMANDS = {
    "calibrate": _calibrate,
    "simulate": _simulate,
    "compare": _compare,
    "explore": _explore,
    "info": _info,
}


def _at_least(options: argparse.Namespace, name: str, least: float) -> None:
    """Refuse numbers that mean nothing; NaN is one of them."""
    value = getattr(options, name)
    if not least <= value < float("inf"):
        raise UsageError(f"--{name} {value:g} is out of range", f"give {least:g} or more")


def _refuse_to_overwrite(inputs: Sequence[str | Path], *outputs: str | Path) -> None:
    """Stop before an output replaces what it is made from."""
    taken = {Path(path).expanduser().resolve() for path in inputs}
    for path in outputs:
        if Path(path).expanduser().resolve() in taken:
            raise UsageError(f"{path} is an input and would be overwritten", "give another name")


def _shown(path: Path) -> str:
    """A path as short as it can be told from here."""
    try:
        return str(path.relative_to(Path.cwd()))
    except ValueError:
        return str(path)


def _print_json(document: Mapping[str, Any]) -> None:
    from skin2urdf.report.document import dumps

    print(dumps(document), end="")


def _one_thread() -> None:
    """Keep linear algebra to one thread, unless the environment says otherwise.

    The matrices are many and small: threads that wait for each other make a calibration four
    times slower on a busy machine. Must come before NumPy is imported.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def _tolerant_output() -> None:
    """Let a terminal that lacks a character show a question mark, not a traceback."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
