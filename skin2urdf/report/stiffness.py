"""How stiff joints are that yield under torques which are known, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.report.tables import number

_KNOWN = 3.0
"""Standard deviations from which a compliance is told as a stiffness; others bound it."""


def stiffness_words(
    names: Sequence[str], slides: Sequence[bool] | Bool, compliance: F64, deviation: F64
) -> list[str]:
    """How stiff each joint is, with standard deviation; nothing of joints without known torques.

    Torques that are told as those of the load make all compliances negative: the one that is known
    best tells the sense of all. A single one of the other sense is none that a spring has.

    Args:
        names: D joints.
        slides: (D,) True for prismatic ones.
        compliance: (D,) [rad/(N m), m/N], NaN where it is not known.
        deviation: (D,) its standard deviations.
    """
    out = []
    known = np.divide(compliance, deviation, out=np.zeros(len(names)), where=deviation > 0)
    sense = -1.0 if known[np.nan_to_num(np.abs(known)).argmax()] < 0 else 1.0
    for name, sliding, c, sd in zip(names, slides, sense * compliance, deviation, strict=True):
        if not np.isfinite(c):
            continue
        unit = "kN/m" if sliding else "kNm/rad"
        if c > _KNOWN * sd:
            k = 1e-3 / c
            out.append(f"{name}: {number(k)} +- {number(k * sd / c)} {unit}")
        else:
            least = 1e-3 / (max(c, 0.0) + 2 * sd)
            out.append(f"{name}: its load hardly moves it, more than {number(least)} {unit}")
    return out
