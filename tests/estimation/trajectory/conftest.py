"""The widest band that all samples of logs with patterns may be looked at in."""

from __future__ import annotations

from typing import Any

import pytest

from skin2urdf.signals import sampling
from skin2urdf.signals.band import Cutoffs, suitable_cutoffs


@pytest.fixture
def through_the_patterns_band(monkeypatch: pytest.MonkeyPatch) -> None:
    """Look at all samples through what features have, where most of encoders' noise is."""

    def as_wide(*log: Any) -> Cutoffs:
        wide = suitable_cutoffs(*log).patterns
        return Cutoffs(wide, wide)

    monkeypatch.setattr(sampling, "suitable_cutoffs", as_wide)
