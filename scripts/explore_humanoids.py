"""Algorithm 1 on simulated recordings of humanoids (and arms), held against the known structure.

For each robot and seed: short recordings in which every DoF moves, with SUs on some segments only
(hips and shoulders are three-DoF joints) and several on others, trunk static. Counts the wrong
entries of the activity matrix and says whether the segments, joints and limbs found are the true
ones. "static" is the paper's test alone (0.05 g, two logs with the base turned by 90 degrees); "all
evidence" adds the patterns, on the first log alone, and lets uncertain entries be overruled by
the rest of the matrix.

    python scripts/explore_humanoids.py --seeds 3 --figures /tmp/figures
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from math import radians
from pathlib import Path

import numpy as np

from skin2urdf.arrays import Bool
from skin2urdf.paper.exploration import (
    Exploration,
    explore,
    or_combination,
    static_activity,
)
from skin2urdf.report.figures import draw_exploration
from skin2urdf.signals.features import extract_features
from skin2urdf.signals.sampling import Sampled, sample_recording, static_moves
from skin2urdf.simulation import SimulationSettings, load_robot, simulate
from skin2urdf.simulation.mechanism import load_mechanism
from skin2urdf.structure.activity import activity
from skin2urdf.structure.tree import nested

ROBOTS = ("talos", "romeo", "icub", "simple_humanoid", "g1", "panda")
TILTED = (radians(25.0), radians(15.0), 0.0)
TURNED = (radians(115.0), radians(15.0), 0.0)


@dataclass(frozen=True)
class Result:
    """How one way to the activity matrix did.

    Attributes:
        exploration: what was found.
        wrong: number of wrong entries of the activity matrix.
        exact: True where segments, joints and limbs are the true ones and nothing is violated.
    """

    exploration: Exploration
    wrong: int
    exact: bool


def true_activity(name: str, su_joints: Sequence[int]) -> Bool:
    """(U, D) activity matrix of a robot whose SUs sit on known joints; -1 for the RS."""
    robot = load_robot(name)
    parent = load_mechanism(robot, robot.base_rpy).parent
    active = np.zeros((len(su_joints), len(parent)), dtype=bool)
    for u, joint in enumerate(su_joints):
        while joint >= 0:
            active[u, joint] = True
            joint = int(parent[joint])
    return active


def judge(measured: Bool, truth: Exploration) -> Result:
    """Hold a measured activity matrix against the true exploration."""
    found = explore(measured, truth.su_names, truth.dof_names)
    exact = (
        not found.violations
        and found.segments == truth.segments
        and found.joints == truth.joints
        and found.limbs == truth.limbs
    )
    return Result(found, int((measured != truth.raw).sum()), exact)


def run(name: str, seed: int, poses: int) -> tuple[Result, Result]:
    """Record a robot in two orientations and explore it: by static evidence, by all of it."""
    logs: list[Sampled] = []
    for base in (TILTED, TURNED):
        settings = SimulationSettings(
            n_poses=poses, excite="all", seed=seed, base_rpy=base, imu_rate=200, joint_rate=200
        )
        simulation = simulate(load_robot(name), settings)
        sus = tuple(su.name for su in simulation.truth.sus)
        dofs = simulation.truth.joint_names
        logs.append(sample_recording(simulation.recording, dofs, sus))
    joints = [su.joint for su in simulation.truth.sus]
    truth = explore(true_activity(name, joints), sus, dofs)
    static = or_combination([static_activity(static_moves([log]), len(dofs)) for log in logs])
    seen = activity(extract_features(logs[:1], sus))
    entries, _ = nested(seen.evidence, sus, dofs)
    return judge(static, truth), judge(entries, truth)


def main() -> None:
    """Run all robots and print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("robots", nargs="*", default=ROBOTS, help="names in the folder robots/")
    parser.add_argument("--seeds", type=int, default=1, help="recordings of each robot")
    parser.add_argument("--poses", type=int, default=2, help="poses with patterns in each log")
    parser.add_argument("--figures", type=Path, help="folder for a figure of each robot")
    arguments = parser.parse_args()
    print(
        "| robot | DoFs | SUs | segments | joints | limbs | sub-limbs | static: wrong entries, "
        "exact | all evidence: wrong entries, exact | s |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for name in arguments.robots:
        begin = time.perf_counter()
        results = [run(name, seed, arguments.poses) for seed in range(arguments.seeds)]
        seconds = (time.perf_counter() - begin) / arguments.seeds
        shown = results[0][1].exploration
        cells = [
            f"{sum(r.wrong for r in way)} of {len(way) * shown.raw.size}, "
            f"{sum(r.exact for r in way)} of {len(way)}"
            for way in zip(*results, strict=True)
        ]
        print(
            f"| {name} | {len(shown.dof_names)} | {len(shown.su_names)} | {shown.n_segments} | "
            f"{shown.n_joints} | {len(shown.limbs)} | {len(shown.sub_limbs)} | {cells[0]} | "
            f"{cells[1]} | {seconds:.1f} |",
            flush=True,
        )
        for kind in sorted(
            {v.words for way in results for r in way for v in r.exploration.violations}
        ):
            print(f"|   {kind} |")
        if arguments.figures:
            arguments.figures.mkdir(parents=True, exist_ok=True)
            draw_exploration(shown, arguments.figures / f"{name}.svg")


if __name__ == "__main__":
    main()
