"""Plans by the batch: limits held densely, and the loop from plan over recording to calibration.

`limits` draws robots of 1 to 8 joints without a model, with limits of all sizes (also none), plans
for each, and looks along the polynomials between the points as files have them: no limit may be
left anywhere. `robots` does the same with models, for robots by name or for every
URDF of example-robot-data, and looks for bodies that touch at instants that planning has not
looked at. `loop` simulates the default recording of robots and a planned one of a given part of its
length, calibrates both, and prints the deviations that were predicted, stated and true.

    python scripts/plans.py limits --plans 1000
    python scripts/plans.py robots --names panda ur5 --seeds 20
    python scripts/plans.py loop --names panda ur5 --part 0.5

Exit status: 0; 1 where a limit is left or bodies touch.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from skin2urdf.arrays import F64
from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.result import Calibration
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.errors import PlanError, Skin2UrdfError
from skin2urdf.estimation.uncertainty.observability import aligned_deviations
from skin2urdf.geometry.earth import ANOMALY
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.output import save
from skin2urdf.planning.collisions import CollisionChecker
from skin2urdf.planning.expected import Sensors, expected
from skin2urdf.planning.files import rounded
from skin2urdf.planning.kinematics import PlacedSu, kinematic_model
from skin2urdf.planning.limits import Given, complete
from skin2urdf.planning.pieces import strain
from skin2urdf.planning.plan import make_plan
from skin2urdf.planning.records import Limits, PlanSettings
from skin2urdf.simulation import GRADES, Simulation, SimulationSettings, load_robot, simulate
from skin2urdf.simulation.mechanism import Mechanism, load_mechanism, read_urdf
from skin2urdf.urdf.compare import compare

_ROUNDING = 1e-6
"""By how much rounding in files may take limits beyond what was planned; a millionth of them."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one of the three."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    modes = parser.add_subparsers(dest="mode", required=True)
    limits = modes.add_parser("limits", help="robots of which only limits are known")
    limits.add_argument("--plans", type=int, default=1000)
    limits.add_argument("--first", type=int, default=0, help="seed of the first")
    robots = modes.add_parser("robots", help="robots with models")
    robots.add_argument("--names", nargs="+", required=True)
    robots.add_argument("--seeds", type=int, default=1)
    robots.add_argument("--minutes", type=float, default=3.0)
    loop = modes.add_parser("loop", help="plan, simulate, calibrate")
    loop.add_argument("--names", nargs="+", required=True)
    loop.add_argument("--part", type=float, default=0.5, help="of the default recording's time")
    loop.add_argument("--grade", default="mems", choices=sorted(GRADES))
    loop.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    if options.mode == "limits":
        return many_limits(options.first, options.plans)
    if options.mode == "robots":
        return many_robots(options.names, options.seeds, options.minutes)
    for name in options.names:
        print_loop(name, options.part, options.grade, options.seed)
    return 0


def drawn_limits(rng: np.random.Generator) -> Limits:
    """Limits of a robot that nobody has built."""
    given = {}
    for d in range(int(rng.integers(1, 9))):
        slides = bool(rng.random() < 0.2)
        size = 0.2 if slides else 2.0
        lower, upper = -size * rng.uniform(0.2, 2.0), size * rng.uniform(0.2, 2.0)
        velocity = (0.3 if slides else 1.5) * float(np.exp(rng.normal(0.0, 0.5)))
        acceleration = velocity * float(np.exp(rng.uniform(0.5, 3.0)))
        jerk = acceleration * float(np.exp(rng.uniform(2.0, 6.0)))
        known = rng.random(4) < 0.8
        given[f"joint{d}"] = Given(
            prismatic=slides,
            lower=lower if known[0] else None,
            upper=upper if known[0] else None,
            velocity=velocity if known[1] else None,
            acceleration=acceleration if known[2] else None,
            jerk=jerk if known[3] else None,
        )
    return complete(tuple(given), given)


def many_limits(first: int, plans: int) -> int:
    """Plan for many robots without models; the exit status."""
    worst, outcome, begin = np.zeros(4), Counter[str](), time.monotonic()
    for seed in range(first, first + plans):
        rng = np.random.default_rng(seed)
        limits = drawn_limits(rng)
        settings = PlanSettings(
            minutes=float(rng.uniform(0.8, 4.0)), seed=seed, candidates=60,
            share=float(rng.choice([1.0, 0.5])),
        )  # fmt: skip
        try:
            plan = make_plan(limits, settings)
        except PlanError:
            outcome["refused in words"] += 1
            continue
        used = strain(rounded(plan.trajectory), limits)
        length = abs(plan.trajectory.duration - 60 * settings.minutes)
        worst = np.maximum(worst, used)
        bad = used.max() > 1 + _ROUNDING or length > 0.1
        outcome["limits left" if bad else "within limits"] += 1
        if bad:
            print(f"seed {seed}: {used}, {plan.trajectory.duration} s")
    print(f"{plans} plans in {time.monotonic() - begin:.0f} s: {dict(outcome)}")
    print("largest share of positions, speed, acceleration, jerk:", worst.round(4))
    return int(outcome["limits left"] > 0)


@dataclass(frozen=True, eq=False)
class Subject:
    """A robot of known URDF.

    Attributes:
        mechanism: what of it moves.
        limits: of its joints.
        checker: keeps its bodies apart; None where it has no shapes.
    """

    mechanism: Mechanism
    limits: Limits
    checker: CollisionChecker | None


def subject(name: str) -> Subject:
    """A robot by its name or its file."""
    spec = load_robot(name)
    mechanism = load_mechanism(spec, spec.base_rpy)
    xml = read_urdf(spec)

    def bound(value: float) -> float | None:
        return float(value) if np.isfinite(value) else None

    rows = zip(
        mechanism.joint_names, mechanism.prismatic, mechanism.lower, mechanism.upper,
        mechanism.speed_limit, strict=True,
    )  # fmt: skip
    given = {n: Given(bool(p), bound(a), bound(b), bound(v)) for n, p, a, b, v in rows}
    limits = complete(mechanism.joint_names, given)
    checker = None
    if xml.find("link/collision") is not None:
        checker = CollisionChecker(
            xml, Path(spec.urdf), limits.joint_names, mechanism.locked, (limits.lower, limits.upper)
        )
    return Subject(mechanism, limits, checker)


def many_robots(names: Sequence[str], seeds: int, minutes: float) -> int:
    """Plan for robots with models; the exit status."""
    wrong = 0
    for name in names:
        of = subject(name)
        for seed in range(seeds):
            begin = time.monotonic()
            settings = PlanSettings(minutes=minutes, seed=seed)
            try:
                plan = make_plan(of.limits, settings, checker=of.checker)
            except PlanError as error:
                print(f"{name} {seed}: refused: {error}")
                continue
            seconds = time.monotonic() - begin
            trajectory = rounded(plan.trajectory)
            used = strain(trajectory, of.limits)
            rng = np.random.default_rng(seed)
            q = trajectory.at(rng.uniform(0.0, trajectory.duration, 2000))[0]
            touching = sum(of.checker.touches(x) for x in q) if of.checker else 0
            wrong += int(used.max() > 1 + _ROUNDING or touching > 0)
            print(
                f"{name} {seed}: {len(plan.poses)} poses, {trajectory.duration:.0f} s, limits "
                f"{used.max():.4f}, {touching} of {len(q)} instants touch, in {seconds:.1f} s",
                flush=True,
            )
    return int(wrong > 0)


def print_loop(name: str, part: float, grade: str, seed: int) -> None:
    """Compare the default recording of a robot with a planned one, both calibrated."""
    spec = load_robot(name)
    settings = SimulationSettings(grade=grade, seed=seed)
    default = simulate(spec, settings)
    of = subject(name)
    placed = [PlacedSu(su.name, su.joint, su.T_joint_su) for su in default.truth.sus]
    R = np.asarray(pin.rpy.rpyToMatrix(*spec.base_rpy))
    model = kinematic_model(of.mechanism.model, list(of.mechanism.prismatic), R, placed)
    minutes = part * default.recording.duration / 60
    plan = make_plan(of.limits, PlanSettings(minutes=minutes, seed=seed), model, of.checker)
    g, spread = GRADES[grade], 3**-0.5
    sensors = Sensors(
        grade, g.noise_rms * GRAVITY, g.step, spread * g.bias * GRAVITY, spread * g.scale,
        spread * g.cross / 2**0.5,
    )  # fmt: skip
    foreseen = expected(plan.trajectory, model, sensors)
    follow = SimulationSettings(grade=grade, seed=seed, plan=rounded(plan.trajectory))
    planned = simulate(spec, follow)
    known = foreseen.determined
    print(f"{name}, {grade}: position [mm] and orientation [deg] of SUs, rms")
    show("predicted", plan.trajectory.duration, _rms(foreseen.position[known]),
         _rms(foreseen.orientation[known]))  # fmt: skip
    for words, simulation in (("default", default), ("planned", planned)):
        show_found(words, simulation)


def show_found(words: str, simulation: Simulation) -> None:
    """Calibrate a recording, and print what it states and what is true."""
    try:
        found = calibrate(simulation.recording, CalibrationSettings(gravity_deviation=ANOMALY))
    except Skin2UrdfError as error:
        print(f"  {words}: {error}")
        return
    position, orientation = stated(found)
    show(f"{words}, stated", simulation.recording.duration, position, orientation)
    with tempfile.TemporaryDirectory() as folder:
        urdf, _ = save(found, Path(folder) / "robot.urdf")
        truth = Path(folder) / "truth.urdf"
        truth.write_text(simulation.truth.urdf, encoding="utf-8")
        held = compare(urdf, truth, rng=np.random.default_rng(0))
    show(f"{words}, true", simulation.recording.duration, held.position.rms, held.orientation.rms)
    print(f"    {found.quality}, tree {'right' if held.tree_equal else 'WRONG'}", flush=True)


def stated(found: Calibration) -> tuple[float, float]:
    """Deviations that a calibration states of its determined SUs, rms [m], [rad]."""
    low, high = found.limits.T
    q = low + (high - low) * np.random.default_rng(0).random((200, len(low)))
    position, orientation = aligned_deviations(found.estimate, found.observability, q)
    known = np.array([verdict == "determined" for verdict in found.observability.su_verdict])
    return _rms(position[known]), _rms(orientation[known])


def show(words: str, seconds: float, position: float, orientation: float) -> None:
    """Print one row."""
    print(f"  {words:18} {seconds:6.0f} s  {1e3 * position:7.4f}  {np.rad2deg(orientation):8.5f}")


def _rms(values: F64) -> float:
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")


if __name__ == "__main__":
    sys.exit(main())
