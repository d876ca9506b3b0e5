"""What logs without patterns tell at rest and in slow motion: the tree, and directions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from skin2urdf.calibration.by_physics import gained
from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.result import GOOD_FIT
from skin2urdf.calibration.rounds import Logs, Solution, Structure
from skin2urdf.calibration.samples import fit_samples
from skin2urdf.errors import Skin2UrdfError, StructureError
from skin2urdf.estimation.problem.reordered import elsewhere
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.solve.estimate import estimate
from skin2urdf.estimation.start.from_rests import state_of
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.slack import CERTAIN
from skin2urdf.estimation.uncertainty.health import mirrored_sus
from skin2urdf.faults import Fault
from skin2urdf.hypotheses.alone import negated
from skin2urdf.notes import of_kind
from skin2urdf.signals.records import Features
from skin2urdf.structure.activity import Activity
from skin2urdf.structure.from_motion import MotionTree, trees_of_both_kinds
from skin2urdf.structure.gravity import gravity_features, gravity_windows
from skin2urdf.structure.records import KinematicTree
from skin2urdf.structure.still import turned_all_the_same
from skin2urdf.structure.tree_notes import doubt


def estimate_at_rest(logs: Logs, structure: Structure, clock: Clock) -> Solution:
    """The tree and the directions that gravity shows, with mirrored SUs set right.

    An SU that is negated, or left-handed, bends the axes of those next to it: as long as fewer look
    mirrored against the others than not, and less is left once they are negated, more are looked
    for.

    Args:
        logs: the logs.
        structure: what their first features show.
        clock: runs the stages.

    Raises:
        InsufficientDataError: the logs lack what directions need.
        StructureError: no SU feels any joint move, or one turns that every tree says does not.
    """
    best, mirrored = _as_read(logs, structure, clock), frozenset[str]()

    def explained_by(names: frozenset[str]) -> Solution | None:
        """The estimate with some SUs negated; None where it has a place for fewer than the best."""
        try:
            other = _as_read(negated(logs, names), structure, clock)
        except Skin2UrdfError:
            return None
        return other if len(other.found.tree.su_names) >= len(best.found.tree.su_names) else None

    while best.found.misfit > GOOD_FIT:
        also = frozenset(best.found.tree.su_names[u] for u in mirrored_sus(best.found))
        other = explained_by(mirrored ^ also) if also else None
        if other is None or other.found.misfit >= best.found.misfit:
            break
        best, mirrored = other, mirrored ^ also
    # Of an SU that gravity meets from one side nothing shows, and all beyond one that is mirrored
    # are mirror images of it.
    for su in (None, *sorted(mirrored)):
        names = mirrored - {su} if su else _right_before(best.found.tree, mirrored)
        if not 0 < len(names) < len(mirrored):
            continue
        other = explained_by(names)
        if other is None or other.found.misfit > GOOD_FIT:
            continue
        one, there = fit_rigid(best, clock), fit_rigid(other, clock)
        if one is None or there is None or not is_likelier(there, one):
            best, mirrored = other, names
    return replace(best, faults=tuple(Fault("mirrored", su) for su in sorted(mirrored)))


def _right_before(tree: KinematicTree, names: frozenset[str]) -> frozenset[str]:
    """The SUs on the joints right before those that carry some SUs, but for these."""
    joints = {int(tree.su_joint[tree.su_names.index(su)]) for su in names & set(tree.su_names)}
    before = {int(tree.parent[j]) for j in joints if j >= 0} - joints
    return frozenset(su for su, j in zip(tree.su_names, tree.su_joint, strict=True) if j in before)


def _as_read(logs: Logs, structure: Structure, clock: Clock) -> Solution:
    """The tree and the directions that gravity shows; positions stay open.

    Where rests and moves show different trees, or several that they do not tell apart, all of these
    are followed, and all samples decide.
    """
    found = clock.run(
        "structure", lambda tell: trees_of_both_kinds(logs.sampled, logs.su_names, tell=tell)
    )
    features = gravity_features(gravity_windows(logs.sampled, logs.su_names), logs.sampled)

    def solved(best: MotionTree) -> Solution:
        return solved_at_rest(logs, structure.seen, best.tree, state_of(best), clock, features)

    best_first = [trees[0] for trees in found] + [tree for trees in found for tree in trees[1:]]
    candidates = _different(_not_denied(best_first, logs))
    if len(candidates) == 1 or logs.settings.motion != "all":
        return solved(candidates[0])
    return _decided([solved(each) for each in candidates], clock)


def solved_at_rest(
    logs: Logs,
    seen: Activity,
    tree: KinematicTree,
    state: State,
    clock: Clock,
    features: Features | None = None,
) -> Solution:
    """The estimate from what gravity shows.

    Args:
        logs: the logs.
        seen: activity in their first features.
        tree: the structure.
        state: where to begin.
        clock: runs the stages.
        features: those of the logs, where they are known.
    """
    if features is None:
        features = gravity_features(gravity_windows(logs.sampled, logs.su_names), logs.sampled)
    settings = logs.settings.estimation
    found = clock.run(
        "estimation",
        lambda tell: estimate(features, tree, settings, state, search=False, tell=tell),
    )
    return Solution(logs, seen, found, features)


def _different(trees: Sequence[MotionTree]) -> list[MotionTree]:
    """The first tree, and others of the same SUs: those that all samples can compare with it."""
    out = [trees[0]]
    for each in trees[1:]:
        same_sus = set(each.tree.su_names) == set(out[0].tree.su_names)
        if same_sus and not any(each.tree.is_like(other.tree) for other in out):
            out.append(each)
    return out


def _decided(solutions: Sequence[Solution], clock: Clock) -> Solution:
    """The solution that all samples find likeliest, with a note on each that is as likely.

    Where they can not be fitted, the first one is as good as any.
    """
    fits = [(each, fit_rigid(each, clock)) for each in solutions]
    fitted = [(each, along) for each, along in fits if along is not None]
    if not fitted:
        return solutions[0]
    best, along = fitted[0]
    for other, there in fitted[1:]:
        if is_likelier(along, there):
            best, along = other, there
    tree = best.found.tree
    before = of_kind(tree.notes, "other order")
    notes = [note for note in tree.notes if note not in before]
    robot = tree, along.state
    for other, there in fitted:
        if other is not best and not is_likelier(there, along):
            instead = other.found.tree, there.state
            # Either may lack a joint that no SU shows for certain.
            positions = {**there.positions_of_joints, **along.positions_of_joints}
            size = elsewhere(robot, instead, positions)
            notes.append(replace(doubt(tree, other.found.tree), size=size))
    tree = replace(tree, notes=tuple(notes))
    return replace(best, found=replace(best.found, tree=tree))


def fit_rigid(solution: Solution, clock: Clock) -> MotionEstimate | None:
    """All samples, with nothing but a rigid robot."""
    return clock.run("all samples", lambda tell: fit_samples(solution, tell, look_further=False))


def is_likelier(one: MotionEstimate, other: MotionEstimate, certain: float = CERTAIN) -> bool:
    """Whether another fit is the likelier one for certain.

    A gyroscope that contradicts one tree and no other knows which joints turn it. Readings have to
    be likelier in the noise of either fit: one that leaves much of an SU takes it for noisy.
    """
    denied, denied_there = (
        0 if each.gyros is None else int(each.gyros.contradict.sum()) for each in (one, other)
    )
    if denied != denied_there:
        return denied_there < denied
    return gained(one, other) > certain and gained(other, one) < -certain


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
