"""Constants with other values: where they are changed, and what is told of it."""

from __future__ import annotations

import pytest
from sensitive.constants import Constant, another, constants
from sensitive.logs import SEEN_BY
from sensitive.table import changes
from sensitive.trials import Case, Figures, Trial
from sensitivity import cases_of, parser

from skin2urdf.calibration import explanation, result
from skin2urdf.errors import UsageError

CLEAR = Constant("signals/leaps", "_CLEAR")


def a_trial(factor: float, log: str, **figures: object) -> Trial:
    """A trial with some figures."""
    case = Case(CLEAR.module, CLEAR.name, factor, log, 0)
    return Trial(case, Figures(1.0, **figures))  # type: ignore[arg-type]


def test_numbers_of_a_module_are_found_with_their_reasons() -> None:
    (found,) = constants(["signals/leaps"])
    assert (found.module, found.name, found.value) == (CLEAR.module, CLEAR.name, 5.0)
    assert found.reason


def test_a_constant_is_another_one_wherever_it_is_used_and_only_for_a_while() -> None:
    of_result = Constant("calibration/result", "HOPELESS_FIT")
    before = result.HOPELESS_FIT
    with another(of_result, 0.5) as value:
        assert explanation.HOPELESS_FIT == result.HOPELESS_FIT == value == before / 2
    assert explanation.HOPELESS_FIT == result.HOPELESS_FIT == before


def test_whole_numbers_stay_whole_and_become_others() -> None:
    once = Constant("signals/encoders", "_NEARBY")
    with another(once, 0.9) as value:
        assert value == 3.0


def test_what_changes_is_told_with_the_recordings() -> None:
    trials = [a_trial(0.5, "patterns"), a_trial(2.0, "patterns", shift=0.05)]
    assert not {"patterns", ";"} & set(changes(trials).replace(";", " ; ").split())
    trials += [a_trial(2.0, "hit", named=False, shift=1.26)]
    told = changes(trials)
    assert "hit" in told.split(";")[1]
    assert "1.3" in told.split(";")[1]
    assert "hit" not in told.split(";")[0]


def test_rooms_without_recordings_are_named() -> None:
    assert len(cases_of(parser().parse_args(["--rooms", "signals/leaps"]))) == 2 * len(
        SEEN_BY["signals"]
    )
    with pytest.raises(UsageError):
        cases_of(parser().parse_args(["--rooms", "report"]))
