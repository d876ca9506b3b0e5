"""The Cramer-Rao bound of a recording, from the true robot alone."""

from __future__ import annotations

import numpy as np
import pytest
from recording_bound import SENSORS, before, covariance, errors, information, main

from skin2urdf.simulation import SimulationSettings, load_robot, simulate


def test_a_quarter_of_the_readings_doubles_the_errors() -> None:
    settings = SimulationSettings(excite="none", minutes=0.25, seed=1)
    truth = simulate(load_robot("so101"), settings).truth
    D, U, own = len(truth.joint_names), len(truth.sus), 16
    carried = [u for u, su in enumerate(truth.sus) if su.joint > 0]
    found = []
    for held in (1, 4):
        shown = information(truth, settings, held)
        known = before(SENSORS["without scale and cross-axis errors"], D, U, own) / held
        position, turned, each = errors(truth, covariance(shown + known), own, carried)
        assert turned == pytest.approx(float(np.sqrt((each**2).mean())))
        found.append((position, turned))
    assert 0.01 < found[0][0] < 10
    np.testing.assert_allclose(np.divide(*found), 0.5, rtol=1e-3)


def test_what_is_known_of_sensors_is_part_of_the_bound(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--robots", "so101", "--seeds", "1", "--minutes", "0.1"]) == 0
    lines = capsys.readouterr().out.splitlines()[-len(SENSORS) :]
    turned = [
        float(line.split(words)[1].split()[1]) for line, words in zip(lines, SENSORS, strict=True)
    ]
    assert turned == sorted(turned, reverse=True)
    assert turned[0] > 3 * turned[-1]
