"""The rounds of a calibration: features, structure and estimate improve each other.

The first features hold second-order effects of other joints' motion. An estimate predicts them, so
that features taken again are exact, and show the structure more clearly where it was in doubt.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.result import BAD_FIT, GOOD_FIT
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.errors import InsufficientDataError, StructureError
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.solve.estimate import Estimate, estimate
from skin2urdf.estimation.start.from_rests import state_of
from skin2urdf.estimation.start.order import ordered
from skin2urdf.estimation.start.starts import felt_up
from skin2urdf.estimation.uncertainty.health import unlike_the_rest
from skin2urdf.estimation.uncertainty.plausible import are_plausible
from skin2urdf.faults import Fault
from skin2urdf.model.specific_force import AroundPose
from skin2urdf.notes import Note
from skin2urdf.recording.records import Recording
from skin2urdf.signals.features import Curvature, OfSus, extract_features
from skin2urdf.signals.records import Features
from skin2urdf.signals.sampling import Sampled, sampled_together
from skin2urdf.structure.activity import Activity, activity
from skin2urdf.structure.first_features import first_features
from skin2urdf.structure.from_motion import trees_from_motion
from skin2urdf.structure.ordering import places_of
from skin2urdf.structure.records import KinematicTree
from skin2urdf.structure.tree import kinematic_tree


@dataclass(frozen=True, eq=False)
class Logs:
    """Logs on their grids, and the choices made for them.

    Attributes:
        sampled: the logs.
        su_names: U SU names.
        settings: choices.
    """

    sampled: Sequence[Sampled]
    su_names: tuple[str, ...]
    settings: CalibrationSettings

    def of(self, sampled: Sequence[Sampled]) -> Logs:
        """The same of other logs, such as mended ones or a part of them."""
        return replace(self, sampled=sampled)


@dataclass(frozen=True, eq=False)
class Structure:
    """What the first features say about the structure.

    Attributes:
        seen: activity of the SUs.
        tree: the kinematic tree; None where the activity contradicts every tree.
        contradiction: why there is none.
    """

    seen: Activity
    tree: KinematicTree | None
    contradiction: StructureError | None = None

    @property
    def certain_tree(self) -> KinematicTree:
        """The tree.

        Raises:
            StructureError: the activity contradicts every tree.
        """
        if self.tree is None:
            raise self.contradiction or StructureError("there is no tree", "record more moves")
        return self.tree


@dataclass(frozen=True, eq=False)
class Solution:
    """An estimate with all it came from.

    Attributes:
        logs: the logs on their grids, mended where they needed it.
        seen: activity in the first features.
        found: the estimate.
        features: the features it rests on.
        faults: what was mended.
    """

    logs: Logs
    seen: Activity
    found: Estimate
    features: Features
    faults: tuple[Fault, ...] = ()


def sample_logs(
    recordings: Sequence[Recording],
    settings: CalibrationSettings,
    clock: Clock,
) -> Logs:
    """Put recordings on their grids.

    Where all samples count, the slowest moments of a robot that never rests may stand for rests.

    Args:
        recordings: the logs.
        settings: choices.
        clock: runs the stage.

    Raises:
        InsufficientDataError: the logs lack what a calibration needs.
    """
    must_rest = settings.motion != "all" or settings.method == "paper"
    sampled, su_names = clock.run(
        "sampling", lambda tell: sampled_together(recordings, must_rest=must_rest, tell=tell)
    )
    if not settings.gyro:
        sampled = [replace(s, turning=None) for s in sampled]
    if not settings.effort:
        none = np.zeros((0, 0))
        sampled = [replace(s, motion=replace(s.motion, effort=none)) for s in sampled]
    return Logs(sampled, su_names, settings)


def take_features(
    logs: Logs, clock: Clock, curvature: Curvature | None = None, latency: F64 | None = None
) -> Features:
    """Features of all logs, given a prediction of what lies beyond first order if any.

    Raises:
        InsufficientDataError: no pose has a pattern around it, and no rests have readings.
    """
    if curvature is None and latency is None:
        return clock.run("features", lambda tell: first_features(logs.sampled, logs.su_names, tell))
    return clock.run(
        "features",
        lambda tell: extract_features(
            logs.sampled, logs.su_names, curvature=curvature, latency=latency, tell=tell
        ),
    )


def find_structure(logs: Logs, features: Features, clock: Clock) -> Structure:
    """Activity that features show, and the tree that follows from it if there is one."""

    def find() -> Structure:
        seen = activity(features, logs.settings.static_threshold)
        try:
            return Structure(seen, ordered(kinematic_tree(seen, features), features))
        except StructureError as contradiction:
            return Structure(seen, None, contradiction)

    return clock.run("structure", lambda _: find())


def estimate_robot(
    logs: Logs, features: Features, structure: Structure, clock: Clock
) -> Solution | None:
    """The estimate of the structure that the first features show, and the features it settles on.

    Args:
        logs: the logs.
        features: their first features.
        structure: what these show.
        clock: runs the stages.

    Returns:
        The estimate; None where there is no tree to estimate.

    Raises:
        InsufficientDataError: the logs lack what a calibration needs.
    """
    if structure.tree is None:
        return None
    first = _first_estimate(logs, structure.tree, features, clock)
    found, refined = _refined(logs, first, features, clock)
    if is_hopeless(found):
        led = _led_by_motion(logs, first, features, clock)
        found, refined = led or (found, refined)
    found, refined = _with_likely_sensors(logs, found, refined, features, clock)
    return Solution(logs, structure.seen, found, refined)


def _led_by_motion(
    logs: Logs, first: Estimate, features: Features, clock: Clock
) -> tuple[Estimate, Features] | None:
    """The estimate that starts from directions by rests and moves, where that explains more.

    Starts from patterns find one joint after the other, each by those before it: few patterns, a
    bare segment or a mirrored SU lead them astray. Gravity along the whole log shows axes better.

    Args:
        logs: the logs.
        first: an estimate of the right tree, from the first features, that explains nothing.
        features: these.
        clock: runs the stages.
    """
    try:
        best, *_ = clock.run(
            "structure",
            lambda tell: trees_from_motion(logs.sampled, logs.su_names, first.tree, tell=tell),
        )
    except (StructureError, InsufficientDataError):
        return None
    if not best.tree.is_like(first.tree):
        return None
    tree = replace(best.tree, notes=first.tree.notes)
    led = estimate_once(logs, tree, features, state_of(best), clock, search=False)
    if led.misfit >= _CLEARLY_BETTER * first.misfit:
        return None
    return relinearise(logs, tree, features, clock, start=led.state, hopeless=leads_nowhere)


def settle(
    logs: Logs, found: Estimate, features: Features, clock: Clock
) -> tuple[Estimate, Features]:
    """Look at the structure again where the model does not explain the data.

    Args:
        logs: the logs.
        found: the estimate of the structure that the first features show.
        features: its features.
        clock: runs the stages.
    """
    best, refined = found, features
    latest, shown, tried = best, refined, [found.tree]
    for _ in range(2):
        felt = set(latest.tree.joint_names)
        seen = activity(shown, logs.settings.static_threshold)
        moved = zip(seen.dof_names, seen.excited, strict=True)
        deaf = [name for name, excited in moved if excited and name not in felt]
        if latest.cost_per_dof <= GOOD_FIT and not deaf and not unlike_the_rest(latest):
            break
        try:
            again = ordered(kinematic_tree(seen.felt_somewhere(deaf), shown), shown)
        except StructureError:
            break
        if any(again.is_like(other) for other in tried):
            break
        again = replace(again, notes=(*again.notes, Note("second look")))
        tried.append(again)
        try:
            latest, shown = relinearise(logs, again, features, clock)
        except InsufficientDataError:
            break  # a structure of which no estimate can begin explains nothing
        if latest.cost_per_dof < _CLEARLY_BETTER * best.cost_per_dof:
            best, refined = latest, shown
    return _with_an_su_elsewhere(logs, best, refined, features, clock)


def _with_an_su_elsewhere(
    logs: Logs, found: Estimate, refined: Features, features: Features, clock: Clock
) -> tuple[Estimate, Features]:
    """With an SU that does not fit moved by one joint more or less, where all fits then.

    Gaps may leave so little of an SU that the activity of its last joint is missed.
    """

    def fits(latest: Estimate) -> bool:
        return latest.misfit <= GOOD_FIT and not unlike_the_rest(latest)

    odd = unlike_the_rest(found)
    return _moved_by_one(logs, found, refined, features, odd, fits, clock) or (found, refined)


def _with_likely_sensors(
    logs: Logs, found: Estimate, refined: Features, features: Features, clock: Clock
) -> tuple[Estimate, Features]:
    """With SUs whose sensors would be none that exist moved by a joint, where that explains more.

    An SU on a base that sways feels the joint that moves all of it, and has too little of its
    motion: on that joint its sensor would have to measure next to nothing. Where a structure is
    wrong beyond doubt, sensors are the least of it.
    """
    unlikely = _unlikely_sensors(found)
    if not unlikely or leads_nowhere(found):
        return found, refined

    def is_likelier(latest: Estimate) -> bool:
        fewer = len(_unlikely_sensors(latest)) < len(unlikely)
        return fewer and latest.misfit < found.misfit

    better = _moved_by_one(logs, found, refined, features, unlikely, is_likelier, clock)
    if better is None:
        return found, refined
    return _with_likely_sensors(logs, *better, features, clock)


def _unlikely_sensors(found: Estimate) -> tuple[int, ...]:
    """SUs that would need errors that no working sensor has."""
    return tuple(np.flatnonzero(~are_plausible(found.state)).tolist())


def _moved_by_one(
    logs: Logs,
    found: Estimate,
    refined: Features,
    features: Features,
    sus: Sequence[int],
    accept: Callable[[Estimate], bool],
    clock: Clock,
) -> tuple[Estimate, Features] | None:
    """The first estimate that is accepted of those with an SU moved by one joint more or less.

    Args:
        logs: the logs.
        found: an estimate, and
        refined: its features.
        features: those to begin with.
        sus: which SUs to move, one at a time.
        accept: tells of an estimate whether it explains more.
        clock: runs the stages.
    """
    if not sus:
        return None
    # What moves one SU otherwise than it seemed tells nothing of the others.
    seen = activity(refined, logs.settings.static_threshold).as_in(found.tree)
    for place in _next_to(found.tree, sus):
        try:
            again = ordered(kinematic_tree(seen.moved_by(*place), refined), refined)
            again = replace(again, notes=(*again.notes, _elsewhere(*place)))
            if again.is_like(found.tree):
                continue
            latest = relinearise(logs, again, features, clock, hopeless=leads_nowhere)
        except (StructureError, InsufficientDataError):
            continue
        if accept(latest[0]):
            return latest
    return None


def is_hopeless(found: Estimate) -> bool:
    """Whether no estimate explains the readings, before any of them are weighed down."""
    return found.misfit > BAD_FIT


def leads_nowhere(found: Estimate) -> bool:
    """Whether a structure is wrong beyond doubt, as seen in the first features."""
    return found.misfit > _NOWHERE


_NOWHERE = 1000.0
"""Misfit of first features from which a structure is wrong: what lies beyond first order, and is
noise to them, leaves 3 to 70 with the right one, and one SU on a wrong joint 10,000 and more."""


def relinearise(
    logs: Logs,
    tree: KinematicTree,
    features: Features,
    clock: Clock,
    *,
    start: State | None = None,
    hopeless: Callable[[Estimate], bool] | None = None,
) -> tuple[Estimate, Features]:
    """Estimate, take the features again with what the estimate predicts, until it settles.

    Args:
        logs: the logs.
        tree: the structure.
        features: the features to begin with.
        clock: runs the stages.
        start: a state of the tree to begin from, beside those that the features show.
        hopeless: where only an explanation is of use, tells of an estimate that leads to none.
    """
    first = _first_estimate(logs, tree, features, clock, start)
    return _refined(logs, first, features, clock, hopeless)


def _first_estimate(
    logs: Logs, tree: KinematicTree, features: Features, clock: Clock, start: State | None = None
) -> Estimate:
    """An estimate from features as they are, led by the first log where all together mislead."""
    found = estimate_once(logs, tree, features, start, clock)
    if len(logs.sampled) > 1 and is_hopeless(found):
        return _led_by_the_first_log(logs, found, features, clock)
    return found


def _refined(
    logs: Logs,
    found: Estimate,
    features: Features,
    clock: Clock,
    hopeless: Callable[[Estimate], bool] | None = None,
) -> tuple[Estimate, Features]:
    """An estimate from features that are taken again with what it predicts, until it settles."""
    if hopeless is not None and hopeless(found):
        return found, features
    for again in range(logs.settings.relinearisations):
        previous, before = found, features
        features = take_features(
            logs, clock, predicted_curvature(found, features), features.latency
        )
        # Features that no start explains will have none when they change a little.
        found = estimate_once(logs, found.tree, features, previous.state, clock, search=not again)
        # Where swings are wide, most of the first features' noise is what lies beyond first order.
        fallen = _fall_of_noise(before, features)
        gain = fallen * previous.cost_per_dof / max(found.cost_per_dof, 1e-12)
        settled = gain < 1.02 and found.cost_per_dof < GOOD_FIT
        # Robust weights may leave a few poses of an SU, which say little of all the others.
        led_astray = previous.misfit < 2.0 * found.misfit and is_hopeless(found)
        useless = hopeless is not None and hopeless(found)
        if _moved(previous, found) < 1e-4 or settled or led_astray or useless:
            break
    return found, features


def _fall_of_noise(before: Features, after: Features) -> float:
    """Variances of samples in earlier features, over those in later ones of the same poses."""
    if not np.array_equal(before.span, after.span):
        return np.inf
    known = np.isfinite(before.noise) & np.isfinite(after.noise)
    return float(np.median((before.noise[known] / after.noise[known]) ** 2)) if known.any() else 1.0


def _led_by_the_first_log(
    logs: Logs, found: Estimate, features: Features, clock: Clock
) -> Estimate:
    """The estimate that starts from what the first log says alone, where that explains more.

    Starts that have to find the other logs' gravity as well may all lead astray.
    """
    poses = np.flatnonzero(features.log == 0)
    if not len(poses):
        return found
    try:
        alone = estimate_once(logs, found.tree, features.of_poses(poses), None, clock)
    except InsufficientDataError:
        return found
    later = felt_up(alone.state, found.cost, features)[1:]
    start = replace(alone.state, up=np.concatenate([alone.state.up, later]))
    again = estimate_once(logs, found.tree, features, start, clock, search=False)
    return again if again.misfit < found.misfit else found


def estimate_once(
    logs: Logs,
    tree: KinematicTree,
    features: Features,
    start: State | None,
    clock: Clock,
    *,
    search: bool = True,
) -> Estimate:
    """An estimate from features as they are, with an earlier state as a start if any."""
    return clock.run(
        "estimation",
        lambda tell: estimate(
            features, tree, logs.settings.estimation, start, search=search, tell=tell
        ),
    )


_CLEARLY_BETTER = 0.8
"""Cost of another structure or start, over the first one's, from which it is preferred."""


def _next_to(tree: KinematicTree, sus: Sequence[int]) -> Iterator[tuple[str, str, bool]]:
    """SUs, and joints near theirs: those that may move them as well, the nearest first, and theirs.

    Those are beyond their own joint, or beside a joint of their chain: one whose patterns fell into
    gaps seems to be of another branch.
    """
    for u in sus:
        own = int(tree.su_joint[u])
        chain = [-1, *tree.chain(own)]
        for before in reversed(chain):
            for j in np.flatnonzero(tree.parent == before):
                if j not in chain:
                    yield tree.su_names[u], tree.joint_names[j], True
        if own >= 0:
            yield tree.su_names[u], tree.joint_names[own], False


def _elsewhere(su: str, joint: str, moved: bool) -> Note:
    """A note on an SU that is placed against the evidence of its activity."""
    return Note("placed by fit", (su,), (joint,), "active" if moved else "inactive")


def predicted_curvature(found: Estimate, features: Features) -> Curvature:
    """Predicts, from an estimate, what readings hold to first order and beyond around a pose."""
    tree, state = found.tree, found.state
    dof = [features.dof_names.index(n) for n in tree.joint_names]
    column = places_of(tree.su_names, features.su_names)
    model, sensors = state.model(tree), state.sensor_matrix()
    gravity = found.cost.priors.gravity
    rows = [0, *(1 + d for d in dof), *(1 + features.n_dofs + d for d in dof)]

    def predict(q: F64, dq: F64, qd: F64, qdd: F64, log: int) -> OfSus:
        up = state.up[log] * gravity
        around = AroundPose.of(model, sensors, q[dof], dq[:, dof], qd[:, dof], qdd[:, dof], up)

        def of_sus(sus: slice) -> tuple[F64, F64]:
            here = np.flatnonzero((column >= sus.start) & (column < sus.stop))
            at, n_sus = column[here] - sus.start, sus.stop - sus.start
            beyond = np.zeros((len(dq), n_sus, 3))
            beyond[:, at] = around.beyond(here)
            coefficients = np.zeros((1 + 2 * features.n_dofs, n_sus, 3))
            coefficients[np.ix_(rows, at)] = around.coefficients[:, here]
            return beyond, coefficients

        return of_sus

    return predict


def _moved(a: Estimate, b: Estimate) -> float:
    """Largest change of any placement between two estimates [m, and entries of rotations]."""
    joints = np.abs(a.state.T_parent_joint - b.state.T_parent_joint).max(initial=0.0)
    return float(max(joints, np.abs(a.state.T_joint_su - b.state.T_joint_su).max(initial=0.0)))
