"""Features of simulated recordings against Pinocchio's frame Jacobians of the original URDF."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from simulated import (
    PATTERNS,
    changed_joints,
    changed_sus,
    features_of,
    read_features,
    sampled_of,
    simulation,
)

from skin2urdf import notes
from skin2urdf.arrays import F64
from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.errors import InsufficientDataError
from skin2urdf.recording.records import JointStream, SuStream
from skin2urdf.signals.encoder_noise import EncoderNoise
from skin2urdf.signals.features import extract_features
from skin2urdf.signals.records import Features
from skin2urdf.signals.sampling import static_moves
from skin2urdf.simulation import Simulation

KINDS = {"f0": 0, "s": 1, "tau": 2}
FAST: dict[str, Any] = {"imu_rate": 500.0, "joint_rate": 250.0}
"""Of recordings whose clocks are looked at."""


@cache
def first_features() -> Features:
    """Of the plain recording, taken once; several tests hold theirs against them."""
    return features_of(simulation("so101").recording)


def errors(sim: Simulation, features: Features) -> tuple[F64, F64, F64]:
    """Errors of all coefficients (P, U, m, 3), their standard deviations, and what was measured."""
    truth = read_features(sim, features)
    D = features.n_dofs
    information, size = features.information.dense(), np.sqrt(features.information.diagonal())
    scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
    unit = information * scale[..., None] * scale[..., None, :]
    covariance = np.einsum("puii->pui", np.linalg.pinv(unit, rcond=1e-9, hermitian=True)) * scale**2
    variance = covariance[..., None] * features.noise[:, :, None] ** 2
    slope2 = truth[:, :, 1 : 1 + D] ** 2
    variance[:, :, 0] += np.einsum("pudi,pd->pui", slope2, features.encoders.position_sd**2)
    measured = features.information.diagonal() > 0
    return features.coefficients - truth, np.sqrt(variance), measured


def of_kind(values: F64, measured: F64, kind: str) -> F64:
    """(n, 3) the measured rows of one kind."""
    D = (values.shape[2] - 1) // 2
    at = (slice(0, 1), slice(1, 1 + D), slice(1 + D, None))[KINDS[kind]]
    return values[:, :, at][measured[:, :, at]]


def rms(x: F64) -> float:
    return float(np.sqrt(np.mean(x**2)))


@pytest.mark.parametrize(
    "options",
    [{}, {"excite": "all"}, {"grade": "bma150", "upright": True}, {"encoder_bits": None}],
    ids=str,
)
def test_errors_are_what_the_covariances_say(options: dict[str, Any]) -> None:
    """With everything beyond first order predicted by a model, as the pipeline ends with."""
    sim = simulation("so101", **options)
    features = calibrate(sim.recording, PATTERNS).features
    error, sd, measured = errors(sim, features)
    for kind in KINDS:
        z = of_kind(error / np.maximum(sd, 1e-12), measured, kind)
        assert 0.8 < rms(z) < 1.3, kind
        assert np.quantile(abs(z), 0.99) < 4.0, kind
        assert abs(np.mean(z)) < 0.2, kind


def test_gravity_allows_for_what_coarse_encoders_hide_at_rest() -> None:
    """Half a step of 12 bits turns gravity by more than its noise."""
    sim = simulation("so101", encoder_bits=12)
    features = calibrate(sim.recording, PATTERNS).features
    step = 2 * np.pi / 2**12
    assert 0.1 * step < features.encoders.position_sd.mean() <= step
    error, sd, measured = errors(sim, features)
    bare = errors(sim, replace(features, encoders=EncoderNoise()))[1]
    # The size that 68 % of the errors stay within.
    told, untold = (
        np.quantile(abs(of_kind(error / np.maximum(d, 1e-9), measured, "f0")), 0.68)
        for d in (sd, bare)
    )
    assert told < 2.0
    assert untold > 2.0 * told


@pytest.mark.parametrize(
    ("options", "limits"),
    [
        ({}, {"f0": 0.02, "s": 0.25, "tau": 0.02}),
        ({"excite": "all"}, {"f0": 0.1, "s": 4.0, "tau": 0.04}),
    ],
    ids=str,
)
def test_without_a_model_coefficients_are_good_enough_to_start(
    options: dict[str, Any], limits: dict[str, float]
) -> None:
    """What several moving joints add at second order is still in them."""
    sim = simulation("so101", **options)
    features = features_of(sim.recording)
    error, _, measured = errors(sim, features)
    # Poses of the structural moves excite next to nothing; those with patterns count, whatever
    # noise they meet.
    sharp = replace(features.information, gain=features.information.gain > 0).diagonal()
    for kind, limit in limits.items():
        weight = of_kind(sharp[..., None] * np.ones(3), measured, kind)
        size = np.sqrt(np.average(of_kind(error, measured, kind) ** 2, weights=weight))
        assert size < limit, kind


def test_a_pose_in_which_nothing_moves_says_all_about_gravity() -> None:
    """Second-order regressors of joints that keep still would take its few samples for noise."""
    features = features_of(simulation("so101", excite="all").recording)
    sharp = features.information.diagonal()
    quiet = ~(sharp[:, :, 1:] > 0).any(axis=(1, 2))
    assert quiet.sum() >= features.n_dofs
    assert sharp[quiet, :, 0].min() > 1.0


def test_poses_are_where_the_robot_really_rested() -> None:
    sim = simulation("so101")
    features = first_features()
    order = [sim.truth.joint_names.index(n) for n in features.dof_names]
    commanded = sim.truth.poses[:, order]
    distance = abs(features.q[:, None] - commanded).max(axis=2)
    # Joints sag by a few milliradian; apart from home and the structural poses nothing is added.
    assert (distance.min(axis=0) < 0.02).all()
    assert features.n_poses == len(commanded) + 1 + features.n_dofs


@pytest.mark.parametrize(
    ("seed", "options"), [(1, {}), (2, {"excite": "all"}), (0, {}), (3, {"excite": "all"})]
)
def test_lags_of_up_to_30_ms_are_recovered(seed: int, options: dict[str, Any]) -> None:
    sim = simulation("so101", lag=0.03, seed=seed, **FAST, **options)
    names = [su.name for su in sim.recording.sus]
    sampled = sampled_of(sim.recording)
    features = extract_features([sampled], names)
    order = [[su.name for su in sim.truth.sus].index(n) for n in features.su_names]
    moving = np.array([sim.truth.sus[u].joint >= 0 for u in order])
    # What was found from the whole log is taken off before, and what is left after it.
    early = {clock.su: clock.latency for clock in sampled.clocks}
    error = features.latency + [early.get(n, 0.0) for n in names] - sim.truth.lag[order]
    # A drift that the whole log leaves in doubt shifts clocks within that doubt.
    half = 0.5 * sim.recording.duration
    doubt = {clock.su: clock.latency_sd + half * clock.drift_sd for clock in sampled.clocks}
    allowed = np.array([2e-4 + 3 * doubt.get(n, 0.0) for n in names])
    assert sim.truth.lag.max() > 0.012
    assert (abs(error) < allowed)[moving].all()
    assert (abs(error) < 6e-4)[moving].all()
    assert (features.latency_sd[moving] < 2e-4).all()


def test_no_lag_is_found_where_there_is_none() -> None:
    features = first_features()
    assert abs(features.latency).max() < 1e-4


def test_noisy_stamps_of_the_joints_make_all_latencies_less_certain() -> None:
    """In all alike, by the mean error of the stamps while the joints move."""
    sim, first = simulation("so101"), first_features()

    def noisy(j: JointStream) -> JointStream:
        return replace(j, stamp_noise=2e-3)

    features = features_of(changed_joints(sim.recording, noisy))
    known = np.isfinite(first.latency_sd)
    added = features.latency_sd[known] ** 2 - first.latency_sd[known] ** 2
    np.testing.assert_allclose(added, added[0], rtol=1e-6)
    samples = 250.0 * sim.recording.duration
    assert 2e-3 / np.sqrt(samples) < np.sqrt(added[0]) < 2e-3 / np.sqrt(0.05 * samples)


def test_a_start_for_the_latency_does_not_decide_it() -> None:
    sim = simulation("so101")
    names = [s.name for s in sim.recording.sus]
    sampled = [sampled_of(sim.recording)]
    away = extract_features(sampled, names, latency=np.full(len(names), 0.004))
    moving = np.array([su.joint >= 0 for su in sim.truth.sus])
    np.testing.assert_allclose(away.latency[moving], 0.0, atol=1e-4)


def test_readings_in_g_are_recognised() -> None:
    sim = simulation("so101")

    def in_g(su: SuStream) -> SuStream:
        return replace(su, specific_force=su.specific_force / 9.81)

    features = features_of(changed_sus(sim.recording, in_g))
    plain = first_features()
    np.testing.assert_allclose(features.f0, plain.f0, atol=1e-6)
    np.testing.assert_allclose(features.tau, plain.tau, atol=1e-6)
    expected = [notes.Note("unit g", (name,)) for name in features.su_names]
    assert notes.of_kind(features.notes, "unit g") == expected
    assert not notes.of_kind(plain.notes, "unit g")


def test_one_su_in_g_is_named_alone() -> None:
    sim = simulation("so101")
    odd = sim.recording.sus[3].name

    def change(su: SuStream) -> SuStream:
        return replace(su, specific_force=su.specific_force / 9.81) if su.name == odd else su

    features = features_of(changed_sus(sim.recording, change))
    assert notes.of_kind(features.notes, "unit g") == [notes.Note("unit g", (odd,))]


def test_a_gap_costs_its_samples_and_nothing_else() -> None:
    """Half a second without readings in the middle of a pattern."""
    sim = simulation("so101")
    odd = sim.recording.sus[2].name
    middle = 0.6 * sim.recording.duration

    def torn(su: SuStream) -> SuStream:
        if su.name != odd:
            return su
        keep = abs(su.time - middle) > 0.25
        return replace(su, time=su.time[keep], specific_force=su.specific_force[keep])

    features, plain = features_of(changed_sus(sim.recording, torn)), first_features()
    others = [u for u, name in enumerate(plain.su_names) if name != odd]
    # Latencies are searched for anew, so the others agree to their precision only.
    np.testing.assert_allclose(
        features.coefficients[:, others], plain.coefficients[:, others], atol=1e-6
    )
    u = plain.su_names.index(odd)
    lost = plain.information.diagonal()[:, u, 0] - features.information.diagonal()[:, u, 0]
    assert (lost > 1.0).sum() <= 1
    assert features.valid[:, u].all()


def test_an_su_that_hardly_speaks_at_rest_still_tells_what_moves_it() -> None:
    """Gaps in every rest: what is left of each shows gravity before and after a move."""
    sim = simulation("so101")
    odd = sim.recording.sus[2].name
    rng = np.random.default_rng(0)

    def torn(su: SuStream) -> SuStream:
        if su.name != odd:
            return su
        lost = np.zeros(len(su.time), dtype=bool)
        for begin in np.arange(su.time[0], su.time[-1], 0.8):
            lost |= abs(su.time - begin - rng.uniform(0.0, 0.5)) < 0.15
        return replace(su, time=su.time[~lost], specific_force=su.specific_force[~lost])

    features, plain = features_of(changed_sus(sim.recording, torn)), first_features()
    u = plain.su_names.index(odd)
    np.testing.assert_allclose(features.moves.change[:, u], plain.moves.change[:, u], atol=0.02)


@pytest.mark.parametrize(("period", "speaks"), [(14.0, 3.9), (6.0, 1.8), (5.2, 1.5), (3.6, 1.05)])
def test_motion_in_too_few_samples_is_not_taken_for_noise(period: float, speaks: float) -> None:
    """An SU that speaks for moments of a pattern is not heard there, instead of being misread."""
    sim = simulation("so101")
    odd = sim.recording.sus[2].name
    plain = first_features()
    u, pose = plain.su_names.index(odd), plain.n_poses - 1
    begin, end = plain.span[pose]

    def torn(su: SuStream) -> SuStream:
        if su.name != odd:
            return su
        keep = (su.time < begin) | (su.time > end) | ((su.time - begin) % period < speaks)
        return replace(su, time=su.time[keep], specific_force=su.specific_force[keep])

    noise = features_of(changed_sus(sim.recording, torn)).noise[pose, u]
    assert np.isinf(noise).all() or (noise < 0.05).all()


def test_an_su_that_dies_keeps_what_it_said() -> None:
    sim = simulation("so101", **FAST)
    odd, half = sim.recording.sus[1].name, 0.6 * sim.recording.duration

    def dies(su: SuStream) -> SuStream:
        keep = (su.time < half) | (su.name != odd)
        return replace(su, time=su.time[keep], specific_force=su.specific_force[keep])

    features, plain = (
        features_of(log) for log in (changed_sus(sim.recording, dies), sim.recording)
    )
    u = plain.su_names.index(odd)
    valid = features.valid[:, u]
    assert 0 < valid.sum() < plain.n_poses
    assert np.isinf(features.noise[~valid, u]).all()
    assert not features.information.dense()[~valid, u].any()
    whole = valid & np.isclose(
        features.information.diagonal()[:, u, 0], plain.information.diagonal()[:, u, 0], 1e-3
    )
    assert whole.sum() >= valid.sum() - 1
    np.testing.assert_allclose(features.f0[whole, u], plain.f0[whole, u], atol=1e-4)


def test_static_moves_are_those_of_the_structural_phase() -> None:
    sim = simulation("so101")
    features = first_features()
    moves = features.moves
    assert set(moves.dof) == set(range(features.n_dofs))
    assert all((moves.dof == d).sum() == 2 for d in range(features.n_dofs))
    # There and back again.
    for d in range(features.n_dofs):
        there, back = np.flatnonzero(moves.dof == d)
        assert moves.distance[there] == pytest.approx(-moves.distance[back], abs=0.02)
        np.testing.assert_allclose(moves.change[there], -moves.change[back], atol=0.25)
    mechanism_order = list(sim.truth.joint_names)
    base = [u for u, n in enumerate(features.su_names) if _joint_of(sim, n) < 0]
    last = features.dof_names.index(mechanism_order[-1])
    assert abs(moves.change[:, base]).max() < 0.02
    before_last = [
        u for u, n in enumerate(features.su_names)
        if _joint_of(sim, n) < len(mechanism_order) - 1
    ]  # fmt: skip
    # Only sag moves what lies before the joint.
    assert abs(moves.change[moves.dof == last][:, before_last]).max() < 0.15


def test_single_samples_far_off_leave_no_trace() -> None:
    """One in a thousand is off by up to 2 g, as of a bus that garbles bits."""
    rng = np.random.default_rng(0)

    def spiked(su: SuStream) -> SuStream:
        values = np.array(su.specific_force)
        hit = rng.random(len(values)) < 1e-3
        values[hit] += rng.uniform(5.0, 20.0, (int(hit.sum()), 3))
        return replace(su, specific_force=values)

    found, plain = features_of(changed_sus(simulation("so101").recording, spiked)), first_features()
    heard = np.isfinite(plain.noise).all(axis=2) & np.isfinite(found.noise).all(axis=2)
    assert heard.sum() > 0.9 * np.isfinite(plain.noise).all(axis=2).sum()
    assert np.median(found.noise[heard] / plain.noise[heard]) == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose(found.f0[heard], plain.f0[heard], atol=0.01)


def test_features_of_some_poses_are_theirs_throughout() -> None:
    features = first_features()
    chosen = np.array([2, 0])
    part = features.of_poses(chosen)
    assert part.n_poses == 2
    for name in ("q", "coefficients", "noise", "span"):
        np.testing.assert_array_equal(getattr(part, name), getattr(features, name)[chosen])
    for name in ("position_sd", "pull", "white"):
        np.testing.assert_array_equal(
            getattr(part.encoders, name), getattr(features.encoders, name)[chosen]
        )


def test_joints_that_creep_by_counts_veto_no_move() -> None:
    """A held joint goes on by a few steps of a coarse encoder at every rest, as an iCub's do."""
    sim = simulation("so101")
    held, step = sim.recording.joints[3].name, 1.5e-3

    def creeping(joint: JointStream) -> JointStream:
        rounded = np.round(joint.position / step) * step
        if joint.name == held:
            rounded = step * (np.arange(len(rounded)) // 700 % 4)
        return replace(joint, position=rounded)

    sampled = sampled_of(changed_joints(sim.recording, creeping))
    moves = static_moves([sampled])
    d = sampled.motion.dof_names.index(held)
    assert moves.moved.sum() == len(moves.moved) - 1
    assert not moves.moved[d]
    others = set(range(len(moves.moved))) - {d}
    assert others <= set(moves.dof)
    assert d not in moves.dof


def test_a_rest_is_compared_with_an_earlier_one_that_only_one_joint_lies_between() -> None:
    """Rests out of their order: what two joints did in a row is taken apart."""
    sampled = sampled_of(simulation("so101").recording)
    first = sampled.rests[0]
    places = np.zeros((4, len(first.q)))
    places[1, 0] = 0.8
    places[2:, 3] = 0.7
    places[2:, 2] = 0.5, 0.01
    rests = tuple(replace(first, q=first.q + place) for place in places)
    moves = static_moves([replace(sampled, rests=rests)])
    np.testing.assert_array_equal(moves.dof, [0, 2])
    np.testing.assert_allclose(moves.distance, [0.8, -0.49])
    assert moves.doubt[0] == pytest.approx(0.0, abs=1e-9)
    # The last rest differs from the third by joint 2, and by 0.01 rad of another joint from none.
    assert moves.doubt[1] == pytest.approx(0.0, abs=1e-9)


def _joint_of(sim: Simulation, name: str) -> int:
    return next(su.joint for su in sim.truth.sus if su.name == name)


def test_a_dof_that_never_moves_is_not_measured() -> None:
    sim = simulation("so101")
    still = sim.recording.joints[3].name

    def frozen(joint: JointStream) -> JointStream:
        if joint.name != still:
            return joint
        return replace(joint, position=np.full_like(joint.position, joint.position[0]))

    features = features_of(changed_joints(sim.recording, frozen))
    d = features.dof_names.index(still)
    assert not features.information.diagonal()[:, :, 1 + d].any()
    assert not features.information.diagonal()[:, :, 1 + features.n_dofs + d].any()
    assert not (features.moves.dof == d).any()


def test_logs_keep_their_number_and_share_names() -> None:
    upright, tilted = simulation("panda", upright=True), simulation("panda")
    sampled = [sampled_of(upright.recording), sampled_of(tilted.recording)]
    names = [s.name for s in tilted.recording.sus]
    features = extract_features(sampled, names)
    alone = features_of(tilted.recording)
    assert set(features.log) == {0, 1}
    second = features.log == 1
    np.testing.assert_allclose(features.q[second], alone.q, atol=1e-12)
    np.testing.assert_allclose(features.f0[second], alone.f0, atol=2e-3)


def test_no_pose_with_readings_is_an_error_in_words() -> None:
    """The SUs were recorded at another time than the joints."""
    sim = simulation("so101")

    def late(su: SuStream) -> SuStream:
        return replace(su, time=su.time + 1000.0)

    with pytest.raises(InsufficientDataError) as caught:
        features_of(changed_sus(sim.recording, late))
    assert caught.value.lacks == "poses"
    assert caught.value.remedy


def test_features_of_some_poses_are_those_of_one_log() -> None:
    whole = features_of(simulation("so101", imu_rate=250.0).recording)
    chosen = np.array([3, 1])
    part = whole.of_poses(chosen)
    assert part.n_poses == 2
    assert part.log.tolist() == [0, 0]
    np.testing.assert_array_equal(part.q, whole.q[chosen])
    np.testing.assert_array_equal(part.coefficients, whole.coefficients[chosen])
    np.testing.assert_array_equal(part.encoders.hidden, whole.encoders.hidden[chosen])
    np.testing.assert_array_equal(part.span, whole.span[chosen])
    np.testing.assert_array_equal(part.information.dense(), whole.information.dense()[chosen])
