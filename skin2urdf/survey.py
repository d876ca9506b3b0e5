"""Looking into logs short of a calibration: what they hold, and what moves with what."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from skin2urdf.arrays import Bool, Record, frozen
from skin2urdf.errors import (
    InsufficientDataError,
    Skin2UrdfError,
    StructureError,
    UnreadableInputError,
)
from skin2urdf.estimation.start.order import ordered
from skin2urdf.notes import Noted
from skin2urdf.paper.exploration import Exploration
from skin2urdf.paper.exploration import explore as run_algorithm_1
from skin2urdf.recording.inventory import LogInventory
from skin2urdf.recording.progress import Share
from skin2urdf.recording.reading import inventory, read
from skin2urdf.recording.records import Recording
from skin2urdf.signals.motion import travel
from skin2urdf.signals.records import Features
from skin2urdf.signals.sampling import Sampled, sampled_together
from skin2urdf.structure.activity import STATIC_THRESHOLD, Activity, activity
from skin2urdf.structure.first_features import first_features
from skin2urdf.structure.from_motion import trees_from_motion
from skin2urdf.structure.records import KinematicTree
from skin2urdf.structure.tree import kinematic_tree, nested

Progress = Callable[[str, float], None]
"""Called with the name of a stage and the share of it that is done, in [0, 1]."""


@dataclass(frozen=True, eq=False)
class Explored:
    """Structure as logs show it.

    Attributes:
        activity: evidence of single moves and of patterns, for every SU and DoF.
        exploration: every step of the paper's Algorithm 1 on the activity matrix as it is, or as
            the tree has it where that is grown from motion; with the constraints it violates.
        tree: the kinematic tree; None where the evidence contradicts every tree.
        contradiction: what contradicts; None where there is a tree.
        notes: what was found and mended.
        from_motion: whether the tree is grown from rests and moves, since there are no patterns.
    """

    activity: Activity
    exploration: Exploration
    tree: KinematicTree | None
    contradiction: StructureError | None
    notes: tuple[Noted, ...]
    from_motion: bool = False


ProblemKind = Literal[
    "refused", "no motion", "no readings", "still joint", "small moves", "no patterns", "few poses",
    "one pattern", "no pattern", "no structural moves",
]  # fmt: skip
"""What a log lacks: what a calibration would refuse it for; motion of all or of one joint; readings
of all SUs or of one; patterns, or poses with patterns, of all or of one joint; structural moves."""


@dataclass(frozen=True)
class Problem:
    """What stands in the way of a calibration, or would make it better.

    Attributes:
        kind: what sort of problem.
        words: the same for the user.
        name: the joint or SU; empty where it is about all of them.
        number: of poses; NaN without any.
    """

    kind: ProblemKind
    words: str
    name: str = ""
    number: float = math.nan


@dataclass(frozen=True, eq=False)
class Surveyed(Record):
    """What one log holds, as far as it can be used.

    Attributes:
        inventory: topics and messages.
        recording: joints and SUs; None where the log lacks either.
        sampled: the robot's motion and rests; None where there are none to find.
        features: readings around its poses; None where no pose can be used.
        excited: (P, D) poses and DoFs with a pattern; (0, D) without features.
        problems: what stands in the way of a calibration or would make it better, the gravest
            first.
        obstacles: those of them without whose cure there is no calibration.
    """

    inventory: LogInventory
    recording: Recording | None
    sampled: Sampled | None
    features: Features | None
    excited: Bool
    problems: tuple[Problem, ...]
    obstacles: tuple[Problem, ...] = ()


def explore(
    logs: Sequence[str | Path],
    threshold: float = STATIC_THRESHOLD,
    *,
    progress: Progress | None = None,
) -> Explored:
    """Find the structure of the robot that one or several logs show.

    Args:
        logs: paths of the logs, all of one robot.
        threshold: change of a static reading that makes an SU active [m/s^2].
        progress: told how far each stage is.

    Raises:
        UnreadableInputError: a log can not be read.
        InsufficientDataError: no pose can be used.
    """
    tell = progress or (lambda _stage, _share: None)
    recordings = []
    for i, log in enumerate(logs):

        def part(share: Share, i: int = i) -> None:
            tell("reading", share.among(i, len(logs)))

        recordings.append(read(log, part))
    tell("features", 0.0)
    sampled, sus = sampled_together(recordings, must_rest=False)
    features = first_features(sampled, sus)
    tell("features", 1.0)
    seen = activity(features, threshold)
    tell("structure", 0.0)
    explored = (
        _from_patterns(seen, features)
        if seen.patterns_felt
        else _from_motion(seen, sampled, sus, lambda share: tell("structure", share))
    )
    tell("structure", 1.0)
    return replace(explored, notes=tuple(dict.fromkeys((*features.notes, *explored.notes))))


def _from_patterns(seen: Activity, features: Features) -> Explored:
    """The tree that activity shows."""
    steps = _exploration(seen)
    try:
        tree = ordered(kinematic_tree(seen, features), features)
    except StructureError as error:
        return Explored(seen, steps, None, error, ())
    return Explored(seen, steps, tree, None, tree.notes)


def _from_motion(
    seen: Activity,
    sampled: Sequence[Sampled],
    su_names: Sequence[str],
    tell: Callable[[float], None],
) -> Explored:
    """The tree that explains gravity at rest and the accelerations of moves."""
    try:
        tree = trees_from_motion(sampled, su_names, tell=tell)[0].tree
    except StructureError as error:
        return Explored(seen, _exploration(seen), None, error, (), from_motion=True)
    matrix = np.zeros_like(seen.matrix)
    column = [seen.dof_names.index(name) for name in tree.joint_names]
    for name, joint in zip(tree.su_names, tree.su_joint, strict=True):
        matrix[seen.su_names.index(name), [column[j] for j in tree.chain(int(joint))]] = True
    steps = run_algorithm_1(
        matrix,
        seen.su_names,
        seen.dof_names,
        excited=seen.excited,
        heard=seen.heard & np.isin(seen.su_names, tree.su_names),
    )
    return Explored(seen, steps, tree, None, tree.notes, from_motion=True)


def _exploration(seen: Activity) -> Exploration:
    """The paper's Algorithm 1 on the activity matrix."""
    return run_algorithm_1(
        _mended(seen), seen.su_names, seen.dof_names, excited=seen.excited, heard=seen.heard
    )


def _mended(seen: Activity) -> Bool:
    """The activity matrix with its undecided bits as a tree asks for; as it is, without a tree."""
    bits = np.array(seen.matrix)
    heard = np.flatnonzero(seen.heard)
    with suppress(StructureError):
        bits[heard], _ = nested(
            seen.evidence[heard], [seen.su_names[u] for u in heard], seen.dof_names
        )
    return bits


def survey(log: str | Path, *, progress: Progress | None = None) -> Surveyed:
    """Look through one log; whatever is missing ends up in the problems.

    Args:
        log: path of the log.
        progress: told how far each stage is.

    Raises:
        UnreadableInputError: the file is no log.
    """
    tell = progress or (lambda _stage, _share: None)
    tell("listing", 0.0)
    listed = inventory(log)
    tell("listing", 1.0)
    nothing = frozen([], bool)
    try:
        recording = read(log, lambda share: tell("reading", share))
    except UnreadableInputError as error:
        return Surveyed(listed, None, None, None, nothing, *_hopeless(error, log))
    try:
        (sampled,), sus = sampled_together([recording], must_rest=False)
    except InsufficientDataError as error:
        return Surveyed(listed, recording, None, None, nothing, *_hopeless(error, log))
    tell("features", 0.0)
    try:
        features = first_features([sampled], sus)
    except InsufficientDataError as error:
        problems, obstacles = _hopeless(error, log)
        problems = (*problems, *_weak_motion(sampled))
        return Surveyed(listed, recording, sampled, None, nothing, problems, obstacles)
    tell("features", 1.0)
    excited = excited_dofs(features)
    obstacles = _lacking(sampled, features)
    problems = (*obstacles, *_weak_motion(sampled), *_weak_poses(sampled, features, excited))
    return Surveyed(listed, recording, sampled, features, excited, problems, obstacles)


def excited_dofs(features: Features) -> Bool:
    """(P, D) True where the readings around a pose tell of a pattern on a DoF."""
    D = features.n_dofs
    measured = features.information.diagonal()[:, :, 1 + D :] > 0
    return frozen((measured & features.valid[:, :, None]).any(axis=1), bool)


_ENOUGH_POSES = 6
_ENOUGH_MINUTES = 2.0
_SMALL_MOVE = 0.05


def _lacking(sampled: Sampled, features: Features) -> tuple[Problem, ...]:
    """What no calibration can do without, in a log that can be read."""
    lacking = []
    if not sampled.motion.moved.any():
        words = "no joint moves: record a log in which the robot moves"
        lacking.append(Problem("no motion", words))
    if not features.valid.any():
        words = "no SU has usable readings around any pose: check how they are connected"
        lacking.append(Problem("no readings", words))
    return tuple(lacking)


def _weak_motion(sampled: Sampled) -> list[Problem]:
    """What the motion lacks, whatever the readings are."""
    names, spans = sampled.motion.dof_names, travel(sampled.motion)
    moved = sampled.motion.moved
    still = [name for name, moves in zip(names, moved, strict=True) if not moves]
    lazy = [
        name for name, span, moves in zip(names, spans, moved, strict=True)
        if moves and span < _SMALL_MOVE
    ]  # fmt: skip
    return [
        *(
            Problem("still joint", f"{name} never moves: it will not be in the URDF", name)
            for name in still
        ),
        *(
            Problem("small moves", f"{name} hardly moves: its axis will be uncertain", name)
            for name in lazy
        ),
    ]


def _weak_poses(sampled: Sampled, features: Features, excited: Bool) -> list[Problem]:
    """What the poses lack."""
    problems = []
    if not activity(features).patterns_felt:
        lacking = "no patterns around poses" if sampled.at_rest else "the robot never rests"
        words = (
            f"{lacking}: the moves alone have to show everything, for which "
            f"{_ENOUGH_MINUTES:g} minutes of them and an SU on every segment are good; else move "
            "the joints by about 0.1 rad at 1 to 4 Hz around each pose"
        )
        return [Problem("no patterns", words), *_silent(sampled, features)]
    patterned = int(excited.any(axis=1).sum())
    if patterned < _ENOUGH_POSES:
        words = f"few poses: patterns around {patterned} poses only; {_ENOUGH_POSES} to 12 are good"
        problems.append(Problem("few poses", words, number=patterned))
    for d, name in enumerate(features.dof_names):
        if excited[:, d].sum() == 1:
            problems.append(Problem("one pattern", f"{name} has a pattern in one pose only", name))
        elif not excited[:, d].any():
            words = f"{name} has no pattern: its SUs' positions rest on its moves alone"
            problems.append(Problem("no pattern", words, name))
    if not len(features.moves.dof):
        words = (
            "no structural moves: let one joint at a time move by half a radian, at rest before "
            "and after; patterns alone may do"
        )
        problems.append(Problem("no structural moves", words))
    return [*problems, *_silent(sampled, features)]


def _silent(sampled: Sampled, features: Features) -> list[Problem]:
    """SUs that no pose has readings of, but for those that are told to be at fault."""
    told = {fault.subject for fault in sampled.faults}
    return [
        Problem("no readings", f"{name} has no usable readings around any pose", name)
        for u, name in enumerate(features.su_names)
        if not features.valid[:, u].any() and name not in told
    ]


def _hopeless(
    error: Skin2UrdfError, log: str | Path
) -> tuple[tuple[Problem, ...], tuple[Problem, ...]]:
    """Problems and obstacles of a log that can not be calibrated."""
    said = (Problem("refused", _words(error, log)),)
    return said, said


def _words(error: Skin2UrdfError, log: str | Path) -> str:
    """What an error says, without the path it starts with."""
    text = str(error).removeprefix(f"{log}: ")
    return f"{text}; {error.remedy}" if error.remedy else text
