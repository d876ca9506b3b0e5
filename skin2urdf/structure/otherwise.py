"""SUs that a joint moves otherwise than it goes.

A finger on a four-bar linkage goes round with its drive without turning, and a spindle may be
counted in turns. Such a joint has no place in a tree of joints that turn or slide by what their
positions say, but what it carries feels it all the same.
"""

from __future__ import annotations

from skin2urdf.structure.accelerations import Along, ChainJoint
from skin2urdf.structure.draft import Draft
from skin2urdf.structure.worth import gained, is_gained_throughout, price_of


def that_move_otherwise(draft: Draft, samples: Along, dof: int) -> list[int]:
    """SUs that a joint without a place pushes, though by another way than it goes.

    Where most SUs are pushed it is the robot that is shaken, by the joint's weight.

    Args:
        draft: a tree without the joint.
        samples: the logs.
        dof: the joint.
    """
    price = price_of(samples, 1, len(draft.joints) + 1)
    heard = [u for u, at in enumerate(draft.su_joint) if at >= -1]
    pushed = []
    for u in heard:
        trial = draft.with_joint(
            ChainJoint(dof, "prismatic", (0.0, 0.0, 1.0)), int(draft.su_joint[u]), [], [u]
        )
        gains = gained(draft.judged(samples, u), trial.judged(samples, u))
        if is_gained_throughout(gains, price):
            pushed.append(u)
    return pushed if 2 * len(pushed) <= len(heard) else []
