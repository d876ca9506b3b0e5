"""What encoders do not see is found from the readings, and sound recordings get none of it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from synthetic import RATE, random_state, sampled_trajectory, serial_tree, stays

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.creeping import creeping, homed_anew
from skin2urdf.estimation.trajectory.estimate import estimate_along
from skin2urdf.estimation.trajectory.fit import fit
from skin2urdf.estimation.trajectory.gears import find_harmonics, find_ripples, ripples
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.slack import Lacking, Shared, lacking, size_of, slack
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.unseen import Unseen, together
from skin2urdf.model.specific_force import specific_forces
from skin2urdf.signals.filters import filtered, first_derivative, second_derivative
from skin2urdf.signals.trajectory import Trajectory

_TREE = serial_tree(2)
_UP = np.array([0.0, 0.0, 1.0])
_STAY, _MOVE, _PLACES = 130, 170, 10
_STEP = 1e-4
"""Step of encoders that round off a sixth of the slack at most."""


@cache
def _truth() -> State:
    state = random_state(np.random.default_rng(3), _TREE, 1, 0.3)
    return replace(state, up=_UP[None])


def _crept(theta: F64) -> F64:
    """(N, 2) a coupling that slips with its joint's way, and a potentiometer that warms up."""
    way = np.cumsum(np.abs(np.diff(theta[:, 0], prepend=theta[0, 0])))
    warm = -np.expm1(-np.linspace(0.0, 1.5, len(theta)))
    return np.column_stack([-9e-4 * way, 6e-3 * warm])


def _tabled(theta: F64, off: F64) -> F64:
    """(N, 2) what encoders miss whose tables (2, 9) have an entry at every 0.4 rad."""
    at = np.linspace(-1.6, 1.6, 9)
    return np.column_stack([np.interp(x, at, each) for x, each in zip(theta.T, off, strict=True)])


def _moved(unseen: str) -> tuple[F64, F64]:
    """(N, 2) what encoders say, and by how much links are beyond it."""
    rng = np.random.default_rng(1)
    theta = stays(rng.uniform(-1.5, 1.5, (_PLACES, 2)), _STAY, _MOVE)
    beyond = {
        "nothing": 0 * theta,
        "harmonics": 1.5e-3 * np.sin(theta + 0.3) + 8e-4 * np.sin(2 * theta + 2.0),
        "table": _tabled(theta, 1e-3 * np.random.default_rng(5).standard_normal((2, 9))),
        "ripples": 2e-4 * np.sin(100 * theta + 0.3),
        "planets": 1e-3 * np.sin(5.3 * theta + 0.3),
        "creep": _crept(theta),
        "ratio": theta * np.array([0.0, -0.03]),
        "slack": stays(3e-4 * rng.standard_normal((_PLACES, 2)), _STAY, _MOVE),
    }
    return theta, beyond[unseen]


@cache
def _log(unseen: str) -> Trajectory:
    """Half a minute between ten places, with links off their encoders in some way."""
    rng = np.random.default_rng(2)
    theta, beyond = _moved(unseen)
    q = theta + beyond
    qd = first_derivative(q, RATE)
    qdd = second_derivative(q, RATE)
    truth = _truth()
    ideal = specific_forces(truth.model(_TREE), q, qd, qdd, 9.81 * _UP)
    read = np.einsum("uij,kuj->kui", truth.sensor_matrix(), ideal) + truth.bias
    read = read + 7e-3 * rng.standard_normal(read.shape)
    return sampled_trajectory(theta, read, still_below=1e-3)


@cache
def _fit(unseen: str, step: float = 0.0) -> MotionEstimate:
    """The fit of a log whose encoders have steps of some size."""
    log = replace(_log(unseen), resolution=np.full(2, step))
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    return estimate_along([log], _TREE, _truth(), priors, np.zeros(2))


def test_a_sound_recording_gets_nothing() -> None:
    sound = _fit("nothing")
    assert sound.causes == ()
    assert sound.slack == 0.0
    assert not sound.deflections.any()
    places = slack(_TREE, sound.problem.logs)
    assert places is not None
    assert size_of(sound.problem, sound.fitted, places).gain < 3.0
    assert find_ripples(sound.problem, sound.fitted) == []


@pytest.mark.parametrize("samples", [6845, 6850, 6923])
def test_moments_of_a_robot_that_never_rests_lie_in_its_log(samples: int) -> None:
    """Times that are added up in steps may end beyond the last one, as their rounding adds up."""
    turning = np.cumsum(np.full((samples, 6), 1e-2), axis=0)
    log = sampled_trajectory(turning, np.zeros((samples, 1, 3)))
    places = slack(serial_tree(6), [log])
    assert places is not None
    np.testing.assert_allclose(places.motions[0].sum(axis=1), 2.0)


def test_what_a_fit_lacks_is_seen_together_as_it_is_alone() -> None:
    loose = _fit("slack", 2e-3)
    problem, fitted = _fit("nothing").problem, _fit("nothing").fitted
    problem = problem.again(logs=loose.problem.logs)
    predicted = (problem.predict(fitted.state, 0),)
    held_against = replace(fitted, problem=problem, predicted=predicted)
    places = slack(_TREE, problem.logs)
    gears = ripples(problem.logs, [(k, n) for k in range(2) for n in (1, 2)])
    assert places is not None
    assert gears is not None
    both = lacking(problem, held_against, [places, gears])
    for group, more in enumerate((places, gears)):
        alone = lacking(problem, held_against, [more])
        assert alone.size(0).gain == pytest.approx(both.size(group).gain, rel=1e-5)
        for one, other in zip(alone.pulls(0), both.pulls(group), strict=True):
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * np.abs(other).max())
        for one, other in zip(alone.pull(0), both.pull(group), strict=True):
            # Sums in another order: along what hardly shows, numbers are rounding, and pulls
            # differ by 9e-5 of the largest.
            np.testing.assert_allclose(one, other, rtol=0, atol=5e-4 * np.abs(other).max())
    own = problem.equations(fitted.state, predicted, fitted.weights)
    for name in ("joint", "su", "mixed", "joint_gradient", "su_gradient"):
        one, other = getattr(both.without, name), getattr(own, name)
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-9 * np.abs(other).max())
    wider, weights = both.problem, fitted.weights[0]
    state = replace(fitted.state, unseen=np.zeros(wider.layout.n_unseen))
    still = np.zeros_like(wider.free_su, dtype=np.float64)

    def chi2(at: MotionState) -> float:
        residual = wider.predict(at, 0).residual
        return float((weights * residual**2).sum()) + wider.prior_chi2(at)

    for i in both.groups[0][::4]:
        joint = np.zeros(wider.layout.n_joint)
        joint[i] = 1e-6
        ahead, behind = (wider.layout.moved(state, sign * joint, still) for sign in (1, -1))
        slope = (chi2(ahead) - chi2(behind)) / 2e-6
        # Columns are not low-passed once more, residuals are: what that changes is small.
        scale = 2 * np.sqrt(both.equations.joint[i, i] * chi2(state))
        assert slope == pytest.approx(-2 * both.equations.joint_gradient[i], abs=2e-2 * scale)


def test_motions_that_two_groups_of_numbers_share_are_kept_once() -> None:
    gears = ripples([_log("nothing")], [(0, 1), (1, 1)])
    assert gears is not None
    once, copied = together([gears, gears]), together([gears, replace(gears)])
    assert once.n_numbers == copied.n_numbers == 2 * gears.n_numbers
    assert once.n_columns == gears.n_columns == copied.n_columns / 2
    log = _log("nothing")
    x = np.random.default_rng(0).standard_normal(once.n_numbers)
    np.testing.assert_allclose(once.moved(log, 0, x).q, copied.moved(log, 0, x).q)
    for one, other in zip(once.at_kept([log]), copied.at_kept([log]), strict=True):
        np.testing.assert_array_equal(one[:, once.columns], other[:, copied.columns])


def test_slack_that_rounding_may_have_made_is_asked_for_no_cause() -> None:
    sound, loose = _fit("nothing"), _log("slack")
    problem = sound.problem.again(logs=[loose])
    places = slack(_TREE, [loose])
    assert places is not None
    shown = size_of(problem, fit(problem, sound.fitted.state), places)
    assert shown.gain_beyond(0.0) == shown.gain > 10
    assert shown.gain_beyond(shown.size) == 0.0
    assert shown.gain_beyond(1e-2 * shown.size) > 10
    # Encoders that round off a little less than what is likeliest.
    assert 0.0 < shown.gain_beyond(0.8 * shown.size) < 10
    rounded = _fit("slack", 2 * 0.8 * shown.size)
    assert rounded.causes == ()
    assert not rounded.tried
    assert rounded.problem.unseen is not None
    assert "slack" in _fit("slack", _STEP).causes


def _of_many(size: float) -> Lacking:
    """What 60 SUs on two links show of slack, and of draws of noise like that of their encoders.

    Args:
        size: of slack [rad].
    """
    rng, names = np.random.default_rng(4), tuple(f"su{u}" for u in range(60))
    tree = replace(_TREE, su_names=names, su_joint=np.repeat([0, 1], 30))
    truth = replace(random_state(rng, tree, 1, 0.3), up=_UP[None])
    theta = stays(rng.uniform(-1.5, 1.5, (_PLACES, 2)), _STAY, _MOVE)
    q = theta + stays(size * rng.standard_normal((_PLACES, 2)), _STAY, _MOVE)
    speed, push = first_derivative(q, RATE), second_derivative(q, RATE)
    ideal = specific_forces(truth.model(tree), q, speed, push, 9.81 * _UP)
    read = np.einsum("uij,kuj->kui", truth.sensor_matrix(), ideal) + truth.bias
    read += 7e-3 * rng.standard_normal(read.shape)
    noise = filtered(rng.standard_normal((len(theta), 34)), np.full(41, 3e-4 / 41**0.5))
    log = sampled_trajectory(theta + noise[:, :2], read, still_below=1e-3)
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    found = estimate_along([log], tree, truth, priors, np.zeros(60), look_further=False)
    drawn = filtered(noise[:, 2:], log.taps)
    joint, number = np.tile([0, 1], 16), np.repeat(np.arange(16), 2)
    places = slack(tree, [log])
    assert places is not None
    groups = [places, Unseen(joint, (drawn,), number=number)]
    return lacking(found.problem, found.fitted, groups)


def test_noise_that_many_sus_share_is_no_slack() -> None:
    sound, loose = _of_many(0.0), _of_many(3e-4)
    assert sound.size(0).gain > 100
    assert sound.size(0, Shared(draws=1)).gain < 3
    assert loose.size(0, Shared(draws=1)).gain > 10
    assert loose.size(0, Shared(draws=1)).size == pytest.approx(3e-4, rel=0.5)


def test_what_is_no_larger_than_noise_of_its_own_kind_is_not_shown() -> None:
    loose = _of_many(3e-4)
    assert loose.size(0, Shared(draws=1, loads=0, load=6e-4)).gain < 1
    assert loose.size(0, Shared(draws=1, loads=0, load=1e-5)).gain > 10


@pytest.mark.parametrize(
    ("unseen", "causes"),
    [
        ("harmonics", ("harmonics",)),
        ("table", ("harmonics",)),
        ("ripples", ("ripples",)),
        ("planets", ("ripples", "harmonics")),
    ],
)
def test_uneven_gears_are_found_and_followed(unseen: str, causes: tuple[str, ...]) -> None:
    uneven, log = _fit(unseen), _log(unseen)
    assert uneven.causes == causes
    theta, beyond = (filtered(x, log.taps)[log.kept, 0] for x in _moved(unseen))
    off = uneven.problem.deflections(uneven.fitted.state)[0][:, 0] - beyond
    # Its zero is a free choice of the first joint, and its gain hardly differs from lengths.
    A = np.column_stack([np.ones(len(theta)), theta])
    off -= A @ np.linalg.lstsq(A, off, rcond=None)[0]
    assert off.std() < 0.25 * beyond.std()
    assert uneven.misfit < 1.5


@pytest.mark.parametrize(("unseen", "per_turn"), [("ripples", 100.0), ("planets", 5.3)])
def test_ripples_are_found_by_their_number_per_turn(unseen: str, per_turn: float) -> None:
    wavy, sound = _log(unseen), _fit("nothing")
    problem = MotionProblem(_TREE, [wavy], sound.problem.priors)
    predicted = (problem.predict(sound.fitted.state, 0),)
    found = dict(find_ripples(problem, replace(sound.fitted, predicted=predicted)))
    assert found[0] == pytest.approx(per_turn, abs=0.2)


def test_smooth_errors_are_as_likely_as_their_motions_say() -> None:
    wavy, sound = _log("table"), _fit("nothing")
    problem = MotionProblem(_TREE, [wavy], sound.problem.priors)
    fitted = replace(sound.fitted, predicted=(problem.predict(sound.fitted.state, 0),))
    found = find_harmonics(problem, fitted)
    assert found is not None
    more, size = found
    again = size_of(problem, fitted, more)
    assert (again.size, again.gain) == pytest.approx((size.size, size.gain), rel=1e-6)
    # Along what hardly shows numbers are rounding.
    np.testing.assert_allclose(again.numbers, size.numbers, atol=1e-4 * np.abs(size.numbers).max())
    # Beyond twice per turn they fall.
    assert more.units[0] == more.units[3] == 1.0
    assert (np.diff(more.units[3 : more.n_numbers // 2]) <= 0).all()


def test_ripples_are_of_joints_that_turn() -> None:
    wavy = _log("ripples")
    more = ripples([wavy], [(1, 100)])
    assert more is not None
    assert more.joint.tolist() == [1, 1]
    sliding = replace(_TREE, joint_types=("prismatic", "prismatic"))
    of_sliding = MotionProblem(sliding, [wavy], _fit("nothing").problem.priors)
    assert find_harmonics(of_sliding, _fit("nothing").fitted) is None


def test_a_joint_that_moves_by_less_than_it_says_is_no_uneven_gear() -> None:
    geared = _fit("ratio")
    assert geared.causes == ("ratio",)
    assert geared.ratios[1] == pytest.approx(-0.03, abs=3e-4)
    assert geared.misfit < 1.5
    # What the first joint does beyond its encoder hardly differs from longer arms.
    assert abs(geared.ratios[0]) < 0.005


def test_zeros_that_creep_are_those_that_joints_began_with() -> None:
    crept, log = _fit("creep"), _log("creep")
    assert crept.causes == ("creep",)
    beyond = _moved("creep")[1][log.kept]
    beyond = beyond - beyond[0]
    off = crept.problem.deflections(crept.fitted.state)[0]
    np.testing.assert_allclose(off[0], 0.0, atol=5e-6)
    # The first joint's zero is a free choice, and so is where gravity points then.
    assert np.abs(off - beyond)[:, 1].max() < 0.15 * np.abs(beyond[:, 1]).max()
    assert crept.misfit < 1.5


def test_encoders_homed_anew_between_logs_are_found() -> None:
    early, late, truth = _log("nothing"), _log("nothing"), _truth()
    by = np.array([0.0, 0.02])
    late = replace(late, log=1, q=late.q - by, positions=late.positions - by)
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    start = replace(truth, up=np.tile(_UP, (2, 1)))
    homed = estimate_along([early, late], _TREE, start, priors, np.zeros(2))
    assert homed.causes == ("homed",)
    off = homed.problem.deflections(homed.fitted.state)
    assert not off[0].any()
    np.testing.assert_allclose(off[1][:, 1], 0.02, atol=1e-4)


def test_zeros_of_many_logs_are_not_looked_for() -> None:
    log = _log("nothing")
    assert creeping(_TREE, [log] * 50) is not None
    assert creeping(_TREE, [log] * 51) is None
    assert homed_anew(_TREE, [log] * 200) is None


def test_slack_of_places_is_of_the_size_that_it_has() -> None:
    loose = _fit("slack", _STEP)
    assert loose.causes == ("slack",)
    assert loose.slack == pytest.approx(3e-4, rel=0.8)
    # They are known like gravity's size: all SUs share them.
    shared = loose.information.shared
    assert len(shared) > len(_fit("nothing").information.shared)
    assert np.isfinite(shared).all()


def test_slack_within_half_a_step_of_the_encoders_has_no_other_cause() -> None:
    rounded, loose = _fit("slack", 2e-3), _fit("slack", _STEP)
    assert rounded.causes == ()
    assert rounded.tried == {}
    # It is taken up all the same, and no finer encoder could have made it.
    assert rounded.deflections == pytest.approx(loose.deflections, rel=0.1)
