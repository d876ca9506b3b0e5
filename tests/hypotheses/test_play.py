"""Gears with play let links jump as if they were hit."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.rounds import (
    estimate_robot,
    find_structure,
    sample_logs,
    take_features,
)
from skin2urdf.calibration.samples import fit_samples, stands_out
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.faults import Fault
from skin2urdf.hypotheses.contact import Contact, without_backlash
from skin2urdf.hypotheses.records import Attempt
from skin2urdf.hypotheses.search import Search
from skin2urdf.recording.retiming import retimed
from skin2urdf.simulation import SimulationSettings, load_robot, simulate
from skin2urdf.simulation.defects import Backlash


def test_jumps_within_the_slack_that_all_samples_show_are_no_hits() -> None:
    """Two masses with a gap between them; seven jumps stand out from what patterns explain."""
    settings = SimulationSettings(
        n_poses=3, seed=4, excite="one", imu_rate=250.0, joint_rate=125.0,
        defects=(Backlash(1e-3),),
    )  # fmt: skip
    recording = retimed(simulate(load_robot("so101"), settings).recording)
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


def hit(joint: str, begin: float, size: float = 10.0, log: int = 0) -> Fault:
    return Fault("contact", joint, log=log, begin=begin, end=begin + 0.3, size=size, sus=(joint,))


def test_what_pushes_a_joint_again_and_again_is_the_play_of_its_gear() -> None:
    """Be it a joint's only jump, as others are no weaker; what is far stronger is a hit."""
    loose = Fault("loose", "su", begin=2.0)
    faults = (hit("a", 5.0, 12.0), hit("b", 6.0), loose, hit("a", 9.0), hit("c", 7.0, 90.0))
    told = {(f.kind, f.subject): f for f in without_backlash(faults)}
    assert told.keys() == {
        ("backlash", "a"), ("backlash", "b"), ("loose", "su"), ("contact", "c")
    }  # fmt: skip
    assert [told["backlash", joint].size for joint in "ab"] == [2, 1]
    assert told["backlash", "a"].begin == 5.0


def test_a_hit_that_lasts_is_one_and_so_are_hits_of_several_joints() -> None:
    lasting = (hit("a", 5.0), hit("a", 5.8), hit("b", 9.0))
    assert without_backlash(lasting) == lasting
