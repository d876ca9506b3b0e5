"""Gears with play let links jump as if they were hit, or as if encoders were wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from random_robots import small_arm

from skin2urdf.calibration.by_physics import differs_by_physics
from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.moments import stands_out
from skin2urdf.calibration.rounds import (
    estimate_robot,
    find_structure,
    sample_logs,
    take_features,
)
from skin2urdf.calibration.samples import fit_samples
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.faults import Fault
from skin2urdf.hypotheses.attempts import Search
from skin2urdf.hypotheses.contact import Contact
from skin2urdf.hypotheses.records import Attempt
from skin2urdf.recording.retiming import retimed
from skin2urdf.signals.sampling import Sampled
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.defects import Backlash


def test_jumps_within_the_slack_that_all_samples_show_are_no_hits() -> None:
    """Two masses with a gap between them; eight jumps stand out from what patterns explain."""
    settings = SimulationSettings(
        n_poses=2, seed=5, excite="one", imu_rate=250.0, joint_rate=125.0,
        defects=(Backlash(1e-3),),
    )  # fmt: skip
    recording = retimed(simulate(small_arm(3), settings).recording)
    logs = sample_logs([recording], CalibrationSettings(), Clock())
    features = take_features(logs, Clock())
    first = estimate_robot(logs, features, find_structure(logs, features, Clock()), Clock())
    assert first is not None
    along = fit_samples(first, lambda _: None, without=("drift", "elastic", "base"))
    search, now = Search([recording], logs.settings, Clock(), (), logs), Attempt((), first, logs)
    assert Contact().propose(search, now)
    assert along is not None
    knowing = replace(search, stands_out=partial(stands_out, along, logs.sampled))
    assert not Contact().propose(knowing, now)
    # A joint crosses from one end of its play to the other, whatever is common to all.
    assert along.widest_slack[0].max() > 1.5 * along.slack
    # Nothing was wrong with an encoder where as much slack stays once it is mended.
    mended = replace(first, faults=(Fault("encoder jump", "j2", size=2e-3),))
    plain = replace(along, misfit=1.0)
    assert differs_by_physics(mended, along, plain)
    # Nor did an SU slip where all samples are as likely without: a bias drifts.
    slipped = replace(first, faults=(Fault("loose", "su"),))
    assert differs_by_physics(slipped, along, plain)
    # However much soft gears leave: what was wrong is gone once it is mended.
    assert differs_by_physics(slipped, replace(along, misfit=5.0), replace(along, misfit=4.9))
    assert not differs_by_physics(slipped, replace(along, misfit=4.0), replace(along, misfit=5.0))
    # Nor where all samples are as likely without: rounding makes features tell too much.
    stiff = replace(along, causes=())
    assert differs_by_physics(mended, stiff, replace(plain, causes=()))
    assert not differs_by_physics(mended, stiff, plain)
    left = [replace(p, residual=2 * p.residual) for p in along.fitted.predicted]
    louder = replace(along.fitted, predicted=tuple(left))
    assert not differs_by_physics(mended, stiff, replace(plain, causes=(), fitted=louder))
    # Play that stays says nothing of an SU.
    assert not differs_by_physics(slipped, along, replace(plain, fitted=louder))
    # Logs that need slack only once they are mended were better left alone, however likely.
    assert differs_by_physics(mended, along, replace(plain, causes=(), fitted=louder))
    assert not differs_by_physics(mended, along, replace(along, misfit=20.0))
    assert not differs_by_physics(first, along, plain)
    _only_sus_beyond_a_joint_tell_that_it_was_pushed(along, logs.sampled)
    # A gain that is worth an encoder's zero is not worth the six numbers of a place.
    stiff = replace(plain, causes=())
    slightly = _gaining(stiff, 20.0)
    assert not differs_by_physics(mended, stiff, slightly)
    assert differs_by_physics(slipped, stiff, slightly)


def _gaining(along: MotionEstimate, gain: float) -> MotionEstimate:
    """The fit with residuals upon which it gains so much in the logarithm of the likelihood."""
    fitted = along.fitted
    chi2 = sum(
        float((w[..., :3] * p.residual**2)[p.measured].sum())
        for w, p in zip(fitted.weights, fitted.predicted, strict=True)
    )
    scale = (1 + 2 * gain / chi2) ** 0.5
    left = [replace(p, residual=scale * p.residual) for p in fitted.predicted]
    return replace(along, fitted=replace(fitted, predicted=tuple(left)))


def _only_sus_beyond_a_joint_tell_that_it_was_pushed(
    along: MotionEstimate, sampled: Sequence[Sampled]
) -> None:
    """Two seconds in which some SUs feel 50 m/s^2 that no joint explains."""
    tree, time = along.problem.tree, along.problem.logs[0].time + sampled[0].motion.grid.start
    when = float(time[400]), float(time[440])
    carried = tree.activity()[:, -1]
    assert 0 < carried.sum() < tree.n_sus
    (p,) = along.fitted.predicted
    for shaken in (carried, ~carried):
        residual = p.residual.copy()
        residual[400:440, shaken] += 50.0
        there = replace(along.fitted, predicted=(replace(p, residual=residual),))
        found = replace(along, fitted=there)
        beyond = stands_out(found, sampled, 0, *when, pushed=tree.joint_names[-1])
        assert stands_out(found, sampled, 0, *when)
        assert beyond == bool(shaken[carried].any())
