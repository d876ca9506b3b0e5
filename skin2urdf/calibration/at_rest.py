"""What logs without patterns tell at rest and in slow motion: the tree, and directions."""

from __future__ import annotations

from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.rounds import Logs, Solution, Structure
from skin2urdf.errors import StructureError
from skin2urdf.estimation.solve.estimate import estimate
from skin2urdf.estimation.start.from_rests import state_of
from skin2urdf.structure.from_motion import trees_from_motion
from skin2urdf.structure.gravity import gravity_features, gravity_windows
from skin2urdf.structure.still import turned_all_the_same


def estimate_at_rest(logs: Logs, structure: Structure, clock: Clock) -> Solution:
    """The tree and the directions that gravity shows; positions stay open.

    Args:
        logs: the logs.
        structure: what their first features show.
        clock: runs the stages.

    Raises:
        InsufficientDataError: the logs lack what directions need.
        StructureError: no SU feels any joint move, or one turns that the tree says does not.
    """
    best, *_ = clock.run(
        "structure", lambda tell: trees_from_motion(logs.sampled, logs.su_names, tell=tell)
    )
    turned = turned_all_the_same(logs.sampled, logs.su_names, best.tree)
    if turned:
        raise StructureError(
            f"the moves do not show which joints turn {', '.join(turned)}, although gyroscopes say "
            "that some do",
            "record patterns around the poses, one joint after the other, or a second log with the "
            "base tilted by 20 degrees or more",
        )
    features = gravity_features(gravity_windows(logs.sampled, logs.su_names), logs.sampled)
    settings = logs.settings.estimation
    found = clock.run(
        "estimation",
        lambda tell: estimate(
            features, best.tree, settings, state_of(best), search=False, tell=tell
        ),
    )
    return Solution(logs, structure.seen, found, features)
