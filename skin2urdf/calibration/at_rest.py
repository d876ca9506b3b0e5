"""What logs without patterns tell at rest and in slow motion: the tree, and directions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.rounds import Logs, Solution, Structure
from skin2urdf.calibration.samples import fit_samples
from skin2urdf.errors import StructureError
from skin2urdf.estimation.solve.estimate import estimate
from skin2urdf.estimation.start.from_rests import state_of
from skin2urdf.estimation.trajectory.publishers import likelihood
from skin2urdf.structure.from_motion import MotionTree, trees_of_both_kinds
from skin2urdf.structure.gravity import gravity_features, gravity_windows
from skin2urdf.structure.records import KinematicTree
from skin2urdf.structure.still import turned_all_the_same


def estimate_at_rest(logs: Logs, structure: Structure, clock: Clock) -> Solution:
    """The tree and the directions that gravity shows; positions stay open.

    Where rests and moves show different trees, both are followed, and all samples decide.

    Args:
        logs: the logs.
        structure: what their first features show.
        clock: runs the stages.

    Raises:
        InsufficientDataError: the logs lack what directions need.
        StructureError: no SU feels any joint move, or one turns that every tree says does not.
    """
    found = clock.run(
        "structure", lambda tell: trees_of_both_kinds(logs.sampled, logs.su_names, tell=tell)
    )
    features = gravity_features(gravity_windows(logs.sampled, logs.su_names), logs.sampled)
    settings = logs.settings.estimation

    def solved(best: MotionTree) -> Solution:
        state = state_of(best)
        return clock.run(
            "estimation",
            lambda tell: Solution(
                logs,
                structure.seen,
                estimate(features, best.tree, settings, state, search=False, tell=tell),
                features,
            ),
        )

    first, *others = _not_denied([trees[0] for trees in found], logs)
    others = [each for each in others if _differ(each.tree, first.tree)]
    solutions = [solved(each) for each in (first, *others)]
    if not others or logs.settings.motion != "all":
        return solutions[0]
    return max(solutions, key=lambda each: _likelihood(each, clock))


def _not_denied(trees: Sequence[MotionTree], logs: Logs) -> list[MotionTree]:
    """Trees that no gyroscope denies.

    Raises:
        StructureError: there is none.
    """
    turned = [turned_all_the_same(logs.sampled, logs.su_names, each.tree) for each in trees]
    if all(turned):
        raise StructureError(
            f"the moves do not show which joints turn {', '.join(turned[0])}, although gyroscopes "
            "say that some do",
            "record patterns around the poses, one joint after the other, or a second log with the "
            "base tilted by 20 degrees or more",
        )
    return [each for each, denied in zip(trees, turned, strict=True) if not denied]


def _differ(tree: KinematicTree, other: KinematicTree) -> bool:
    """Whether trees are not the same, but of the same SUs, so that all samples can compare them."""
    return set(tree.su_names) == set(other.su_names) and not tree.is_like(other)


def _likelihood(solution: Solution, clock: Clock) -> float:
    """That of all samples, as the estimate explains them; less than any where these are none."""
    along = clock.run("all samples", lambda tell: fit_samples(solution, tell, look_further=False))
    return -np.inf if along is None else likelihood(along.fitted)
