"""Stages are timed without a gap and without counting anything twice, and tell how far they are."""

from __future__ import annotations

from dataclasses import replace

import pytest
from calibrated import calibration, run
from threadpoolctl import threadpool_info, threadpool_limits

from skin2urdf.calibration.clock import Clock, Tell
from skin2urdf.report.document import as_document
from skin2urdf.report.summary import as_text


class Time:
    """Time that passes where a test lets it pass, however busy the machine is [s]."""

    def __init__(self) -> None:
        self.now = 0.0

    def perf_counter(self) -> float:
        """What has passed so far."""
        return self.now

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        self.now += seconds


@pytest.fixture
def time(monkeypatch: pytest.MonkeyPatch) -> Time:
    passing = Time()
    monkeypatch.setattr("skin2urdf.calibration.clock.time", passing)
    return passing


def test_a_stage_inside_another_is_timed_once(time: Time) -> None:
    clock = Clock()

    def outer(_: Tell) -> None:
        time.sleep(2.0)
        clock.run("inner", lambda _: time.sleep(5.0))
        clock.run("inner", lambda _: time.sleep(5.0))

    clock.run("outer", outer)
    assert clock.seconds == {"inner": 10.0, "outer": 2.0}


def test_a_stage_that_fails_has_taken_its_time_all_the_same(time: Time) -> None:
    clock = Clock()

    def fail(_: Tell) -> None:
        time.sleep(2.0)
        raise ValueError

    with pytest.raises(ValueError):
        clock.run("failing", fail)
    clock.run("next", lambda _: time.sleep(3.0))
    assert clock.seconds == {"failing": 2.0, "next": 3.0}


def test_linear_algebra_has_one_thread_in_every_stage_and_as_many_as_before_after_them() -> None:
    def threads(_: Tell) -> set[int]:
        return {library["num_threads"] for library in threadpool_info()}

    def outer(tell: Tell) -> list[set[int]]:
        return [threads(tell), clock.run("inner", threads), threads(tell)]

    clock = Clock()
    with threadpool_limits(2):
        assert clock.run("outer", outer) == [{1}, {1}, {1}]
        assert threads(lambda _: None) == {2}


def test_all_time_of_a_run_lies_in_stages() -> None:
    assert sum(run().result.seconds.values()) == pytest.approx(run().seconds, rel=0.05)


def test_progress_is_told_stage_by_stage() -> None:
    told = run().told
    assert all(0.0 <= share <= 1.0 for _, share in told)
    stages = list(dict.fromkeys(stage for stage, _ in told))
    assert stages[:5] == ["reading", "clocks", "leaps", "sampling", "features"]
    assert stages[-1] == "observability"
    assert told[-1] == ("observability", 1.0)


def test_the_search_for_hits_tells_its_progress() -> None:
    shares = [share for stage, share in run().told if stage == "hits"]
    assert len(set(shares)) > 3
    assert shares[-1] == max(shares) == 1.0


def test_all_that_takes_long_tells_how_far_it_is() -> None:
    seconds, told = run().result.seconds, run().told
    # Of a log of a million messages, these are the stages that take a second.
    long = [stage for stage, each in seconds.items() if each > 0.05 * run().seconds]
    assert len(long) > 1
    for stage in {"sampling", "features", "estimation", *long}:
        assert {share for of, share in told if of == stage} - {0.0, 1.0}, stage


def test_a_calibration_without_regressions_around_poses_can_be_told() -> None:
    """As of logs that hold no patterns; only what such regressions say is missing then."""
    found = replace(calibration(), features=None)
    with_, without = as_document(calibration()), as_document(found)
    assert as_text(found)
    for name, su in without["sus"].items():
        assert su["latency"] is su["latency_sd"] is None
        assert su["noise"] == with_["sus"][name]["noise"]
        assert su["T_joint_su"] == with_["sus"][name]["T_joint_su"]
    assert {k: v for k, v in without.items() if k != "sus"} == {
        k: v for k, v in with_.items() if k != "sus"
    }
