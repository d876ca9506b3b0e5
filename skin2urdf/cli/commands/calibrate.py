"""``skin2urdf calibrate``: logs to URDF and JSON."""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from skin2urdf.cli.arguments import (
    A_LOG,
    Parser,
    add_number,
    add_threshold,
    check_within,
    number_or_nan,
    offer_json,
    present,
    print_json,
    refuse_to_overwrite,
    static_threshold,
    wrote,
)
from skin2urdf.cli.terminal import progress_bar, show
from skin2urdf.errors import BadFitError, UsageError
from skin2urdf.geometry.units import MILLI_G

if TYPE_CHECKING:
    from skin2urdf.calibration.settings import CalibrationSettings
    from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
    from skin2urdf.vendor.records import Correction

HELP = "find the robot in one or several logs"
EPILOG = """\
example:
  skin2urdf calibrate log.mcap -o robot.urdf
  skin2urdf calibrate upright.mcap tilted.mcap -o robot.urdf --bias 5 --scale 0.003
  skin2urdf calibrate log.mcap --model vendor.urdf -o with_skin.urdf

A log is an MCAP file, a rosbag2 folder or database, a ROS 1 bag or a table (CSV, Parquet) with
joint states and the accelerations of every skin unit (SU). The robot rests in some ten poses and
moves its joints a little around each of them (0.1 rad at 1 to 4 Hz). Several logs are of one robot
whose base was tilted in between.
With --model any motion of half a minute does: the vendor's file is kept byte for byte, and the SUs
are added to its links.
Writes robot.urdf, and robot.json with all that a URDF has no place for.
If it fails, look at the log with `skin2urdf info` and at the structure with `skin2urdf explore`."""

_TO_REPAIR = 3
"""The URDF was written, but an SU, an encoder or the log has to be set right before it fits."""


def declare(command: Parser) -> None:
    """Add what the command takes."""
    command.add_argument("logs", nargs="+", metavar="LOG", help=A_LOG)
    command.add_argument(
        "-o", "--output", required=True, metavar="URDF", help="file to write; JSON goes beside it"
    )
    command.add_argument(
        "--force", action="store_true", help="write the URDF even where the result is bad"
    )
    offer_json(command)
    command.add_argument(
        "--report", metavar="HTML", help="write a page that shows the result as well"
    )
    command.add_argument("--name", help="the robot's name in the URDF (that of the file)")
    command.add_argument("--no-visuals", action="store_true", help="leave out the simple shapes")
    command.add_argument(
        "--collision", action="store_true", help="let the simple shapes collide, too"
    )
    command.add_argument(
        "--limits",
        default="wide",
        metavar="wide|soft|seen|FILE",
        help="of the joints: wide ones that do not bind; the same with what the log saw as soft "
        "limits, which MoveIt and ros_control keep; what the log saw; or those of a URDF, YAML or "
        "TOML file, by joint name (%(default)s)",
    )
    command.add_argument(
        "--method",
        choices=("default", "paper"),
        default="default",
        help="paper: the estimator of Mittendorfer and Cheng, for comparison; it stops far above "
        "the noise (%(default)s)",
    )
    command.add_argument(
        "--refine",
        choices=("casadi", "none"),
        default="none",
        help="how to finish: a second least-squares over the whole tree, or not (%(default)s)",
    )
    model = command.add_argument_group("a robot that is known")
    model.add_argument(
        "--model",
        metavar="URDF",
        help="the vendor's URDF or xacro file, or 'bag' for the /robot_description in the log: SUs "
        "are found on its links, which keep their frames",
    )
    model.add_argument(
        "--correct",
        type=_correction,
        metavar="WHAT",
        help="what of the model to correct: 'zeros' of the encoders (to 5 mrad), or 'all' "
        "placements as well, as all[:MM,DEG] with the standard deviations that its maker would "
        "state (1 mm, 0.1 deg)",
    )
    add_threshold(command)
    sensors = command.add_argument_group("sensors, as standard deviations over a production")
    sensors.add_argument(
        "--no-intrinsics", action="store_true", help="take bias, scale and cross-axis as perfect"
    )
    add_number(sensors, "--bias", None, "bias of an axis [mg] (51)")
    add_number(sensors, "--scale", None, "relative scale error of an axis (0.03)")
    add_number(sensors, "--cross", None, "cross-axis sensitivity (0.02)")
    sensors.add_argument(
        "--bandwidth",
        type=_bandwidth,
        metavar="HZ[:ORDER]",
        help="cutoff of the sensors' low-pass, from the data sheet; order 1 or 2 (1). Else it is "
        "estimated, and taken to be 20 Hz or faster",
    )
    sensors.add_argument(
        "--without",
        action="append",
        default=[],
        metavar="SU",
        help="leave out an SU by its name or topic, or all that a pattern as 'cam*' fits, such as "
        "those that are not on the robot; may be given several times",
    )
    sensors.add_argument(
        "--no-gyro", action="store_true", help="leave out what gyroscopes say, where SUs have them"
    )
    sensors.add_argument(
        "--no-effort", action="store_true", help="leave out the torques that joint states hold"
    )
    lengths = command.add_argument_group(
        "gravity, on which every length rests", "at most one of these"
    ).add_mutually_exclusive_group()
    lengths.add_argument(
        "--gravity",
        type=float,
        metavar="X",
        help="its size where the log was recorded [m/s^2] (9.81, not known to better than 0.02)",
    )
    lengths.add_argument(
        "--site",
        type=_site,
        metavar="LAT[,HEIGHT]",
        help="the same from latitude [deg] (south is negative) and height above the sea [m] (0)",
    )
    command.add_argument(
        "--motion",
        choices=("all", "patterns"),
        default="all",
        help="estimate from all samples of the log, or from the patterns around poses alone "
        "(%(default)s)",
    )


def run(options: argparse.Namespace) -> int:
    """Do it; the exit status."""
    begin = time.perf_counter()
    if options.model is not None:
        return _run_on_model(options, begin)
    if options.correct is not None:
        raise UsageError("--correct says what of a model to correct", "give it with --model")
    with progress_bar(options.quiet) as bar:
        bar("starting", 0.0)
        settings = calibration_settings(options)
        from skin2urdf.output import not_to_be_saved, output_paths, save
        from skin2urdf.urdf.limits import CHOICES, read_limits

        outputs = [*output_paths(options.output), *_pages(options)]
        refuse_to_overwrite([*options.logs, options.limits], *outputs)
        replaced = present(outputs)
        if options.limits not in CHOICES:
            read_limits(options.limits)
        from skin2urdf.calibration.pipeline import calibrate
        from skin2urdf.report.document import as_document
        from skin2urdf.report.findings import is_to_repair
        from skin2urdf.report.summary import as_text

        bar("starting", 1.0)
        calibration = calibrate(options.logs, settings, progress=bar)
        written: tuple[Path, ...] = ()
        if calibration.quality != "bad" or options.force:
            bar("writing", 0.0)
            written = save(
                calibration,
                options.output,
                name=options.name,
                visuals=not options.no_visuals,
                collision=options.collision,
                limits=options.limits,
                even_bad=options.force,
            )
            if options.report:
                bar("drawing", 0.0)
                written = (*written, _report(calibration.along, written[0], options.report))
    if options.json:
        print_json(as_document(calibration))
    elif not options.quiet:
        show(lambda: as_text(calibration) + "\n")
        if written:
            print(wrote(written, replaced, time.perf_counter() - begin))
    # The paper's method gets here with a bad fit, the default one where no SU is known well enough.
    if not written:
        raise not_to_be_saved(calibration, options.output)
    if calibration.quality == "bad":
        return BadFitError.exit_status
    return _TO_REPAIR if is_to_repair(calibration) else 0


def _pages(options: argparse.Namespace) -> list[Path]:
    """Where a page goes, if one is asked for that can be made, before the work that it shows."""
    if not options.report:
        return []
    from skin2urdf.page.html import check_libraries
    from skin2urdf.page.writing import check_page

    check_libraries()
    return [check_page(options.report)]


def _report(along: MotionEstimate | None, urdf: Path, path: str) -> Path:
    """Write the page of a calibration that was just written; where it is."""
    from skin2urdf.page.contents import load_contents
    from skin2urdf.page.html import as_page
    from skin2urdf.page.writing import write_page
    from skin2urdf.replay import traces_of

    contents = replace(load_contents(urdf), traces=traces_of(along))
    return write_page(path, as_page(contents))


def _run_on_model(options: argparse.Namespace, begin: float) -> int:
    """Find SUs on a given model; the exit status."""
    if options.method != "default" or options.motion != "all" or options.refine != "none":
        raise UsageError(
            "--model takes all samples of the log, by one method",
            "leave out --method, --motion and --refine",
        )
    if options.name is not None:
        raise UsageError("a robot with a model has its name", "leave out --name")
    if options.limits != "wide" or options.collision or options.no_visuals:
        raise UsageError(
            "a robot with a model has its limits and shapes",
            "leave out --limits, --collision and --no-visuals",
        )
    settings = calibration_settings(options)
    from skin2urdf.output import output_paths, save_on_model

    outputs = [*output_paths(options.output), *_pages(options)]
    refuse_to_overwrite([*options.logs, options.model], *outputs)
    replaced = present(outputs)
    from skin2urdf.report.model_document import as_document
    from skin2urdf.report.on_model import as_text
    from skin2urdf.vendor.calibrate import calibrate_with_model

    with progress_bar(options.quiet) as bar:
        result = calibrate_with_model(
            options.logs, options.model, settings, options.correct, progress=bar
        )
        bar("writing", 0.0)
        written: tuple[Path, ...] = save_on_model(result, options.output)
        if options.report:
            bar("drawing", 0.0)
            written = (*written, _report(result.along, written[0], options.report))
    if options.json:
        print_json(as_document(result))
    elif not options.quiet:
        print(as_text(result))
        print(wrote(written, replaced, time.perf_counter() - begin))
    return _TO_REPAIR if result.to_repair else 0


def _correction(text: str) -> Correction:
    """What of a model is corrected, and how well it is known."""
    from skin2urdf.vendor.records import Correction

    what, _, sizes = text.partition(":")
    if what == "zeros" and not sizes:
        return Correction("zeros")
    if what != "all":
        raise argparse.ArgumentTypeError(f"{text!r} is neither 'zeros' nor 'all[:MM,DEG]'")
    if not sizes:
        return Correction("all")
    length, _, angle = sizes.partition(",")
    angle_deg = number_or_nan(angle) if angle else 0.1
    found = Correction("all", 1e-3 * number_or_nan(length), math.radians(angle_deg))
    if not (0 < found.length <= 0.1 and 0 < found.angle <= 0.2):
        raise argparse.ArgumentTypeError(f"{text!r}: up to 100 mm and 11 deg are deviations")
    return found


def calibration_settings(options: argparse.Namespace) -> CalibrationSettings:
    """Settings as the options say."""
    from skin2urdf.geometry.earth import ANOMALY, ON_GROUND, normal_gravity

    anything = 0.0, math.inf
    ranges = {"bias": anything, "scale": anything, "cross": anything, "gravity": ON_GROUND}
    given = {name: getattr(options, name) for name in ranges if getattr(options, name) is not None}
    for name in given:
        check_within(options, name, *ranges[name])
    threshold = static_threshold(options)
    if "bias" in given:
        given["bias"] *= MILLI_G
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
        static_threshold=threshold,
        motion=options.motion,
        gyro=not options.no_gyro,
        effort=not options.no_effort,
        bandwidth=options.bandwidth,
        without=tuple(options.without),
    )
    return replace(settings, gravity_deviation=ANOMALY) if "gravity" in given else settings


def _bandwidth(text: str) -> tuple[float, int]:
    """Cutoff [Hz] and order of a low-pass."""
    cutoff, _, order = text.partition(":")
    found = number_or_nan(cutoff)
    if not (1.0 <= found < 1e5 and order in ("", "1", "2")):
        raise argparse.ArgumentTypeError(f"{text!r} is no cutoff of 1 Hz or more, and order 1 or 2")
    return found, int(order or 1)


def _site(text: str) -> tuple[float, float]:
    """Latitude [deg] and height [m]."""
    latitude, _, height = text.partition(",")
    found = number_or_nan(latitude), number_or_nan(height) if height else 0.0
    if not abs(found[0]) <= 90:
        raise argparse.ArgumentTypeError(f"latitude {latitude!r} is not within -90 and 90 deg")
    if not -500 <= found[1] <= 9000:
        raise argparse.ArgumentTypeError(f"height {height!r} is not within -500 and 9000 m")
    return found
