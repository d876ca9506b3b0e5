from __future__ import annotations

import sys

import benchmark_reading
import numpy as np
import pytest


def test_ratios_of_all_readers_in_one_run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--messages", "400", "--topics", "2", "4", "--repeats", "1", "--storages"]
    monkeypatch.setattr(sys, "argv", ["benchmark_reading.py", *words, "lz4, indexed"])
    benchmark_reading.main()
    rows = [line.split() for line in capsys.readouterr().out.splitlines()[2:]]
    assert [row[0] for row in rows] == ["3", "5"]
    for row in rows:
        # How fast a few hundred messages are read is a matter of chance; that all are told is not.
        assert all(ratio.endswith("x") for ratio in row[3:7])
        assert all(0 <= float(told.removesuffix("x")) < np.inf for told in row[3:])
