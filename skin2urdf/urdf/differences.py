"""Where two kinematic trees differ, in words."""

from __future__ import annotations

from collections.abc import Sequence

from skin2urdf.urdf.loading import Robot


def tree_differences(est: Robot, true: Robot, sus: Sequence[str]) -> tuple[str, ...]:
    """Compare joint types, the joints that move SUs, the joints before each SU.

    Args:
        est: the estimated robot.
        true: the true robot.
        sus: the SUs to expect, links of the truth.

    Returns:
        One sentence per difference; none where the trees are equal as far as SUs can tell.
    """
    shared = [name for name in est.joint_types if name in true.joint_types]
    differences = [
        f"joint {name} is {est.joint_types[name]}, but {true.joint_types[name]} in the truth"
        for name in shared
        if est.joint_types[name] != true.joint_types[name]
    ]
    differences += [
        f"joint {name} is not in the truth" for name in est.joint_types if name not in shared
    ]
    for name in true.joint_types:
        moved = [] if name in shared else [su for su in sus if name in true.chain(su)]
        if moved:
            more = f" and {len(moved) - 1} more" if len(moved) > 1 else ""
            differences.append(
                f"joint {name} is not in the estimate; in the truth it moves SU {moved[0]}{more}"
            )
    for su in sus:
        if su not in est.links:
            differences.append(f"SU {su} is not in the estimate")
            continue
        found, right = ([j for j in robot.chain(su) if j in shared] for robot in (est, true))
        if found != right:
            words = [", ".join(chain) or "no joint" for chain in (found, right)]
            differences.append(f"SU {su} hangs on {words[0]}; in the truth on {words[1]}")
    if not sus:
        differences += _orders(est, true, shared)
    return tuple(differences)


def _orders(est: Robot, true: Robot, shared: Sequence[str]) -> list[str]:
    """Joints that come after other joints than in the truth, where no SU shows it."""
    differences = []
    for name in shared:
        chains = [
            [j for j in robot.chain_of_joint(name)[:-1] if j in shared] for robot in (est, true)
        ]
        if chains[0] != chains[1]:
            words = [", ".join(chain) or "the base" for chain in chains]
            differences.append(
                f"joint {name} comes after {words[0]}; in the truth after {words[1]}"
            )
    return differences
