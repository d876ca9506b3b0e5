"""The rows of the bench: what is wrong with a recording, and by how much."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from types import MappingProxyType

from bench.tilting import Tilting
from skin2urdf.simulation.defects import (
    Backlash,
    BiasWalk,
    Bursts,
    CoarseDigits,
    Defect,
    ElasticGears,
    GearHarmonics,
    Glitches,
    Held,
    HeldPositions,
    LinkFlex,
    LocalGravity,
    Lost,
    LowPass,
    Nonlinearity,
    OnChange,
    ReadInTurn,
    SecondPublisher,
    SlippingCoupling,
    SmoothedPositions,
    Spikes,
    Stalls,
    SuClock,
    UnsteadyClock,
    Vibration,
    WarmUp,
    YieldingBase,
)

SOUND = "sound"
"""The row without a defect."""
_ARCMIN = pi / 180 / 60


def _gear(arcmin: float) -> Defect:
    """Errors of a gear once and twice per turn of its joint."""
    return GearHarmonics(once=arcmin * _ARCMIN, twice=0.5 * arcmin * _ARCMIN)


ROWS: Mapping[str, tuple[Defect, ...]] = MappingProxyType(
    {
        SOUND: (),
        "gears 56/28 kNm/rad": (ElasticGears(56e3, 28e3),),
        "gears 14/7 kNm/rad": (ElasticGears(14e3, 7e3),),
        "gears 3.5/1.75 kNm/rad": (ElasticGears(3.5e3, 1.75e3),),
        "links 50 kNm/rad": (LinkFlex(50e3),),
        "base 50 kNm/rad": (YieldingBase(50e3),),
        "backlash 0.3 mrad": (Backlash(0.3e-3),),
        "backlash 1 mrad": (Backlash(1e-3),),
        "gear error 0.5 arcmin": (_gear(0.5),),
        "gear error 1.5 arcmin": (_gear(1.5),),
        "strain wave 0.1 mrad": (GearHarmonics(once=0.0, twice=0.0, motor=0.1e-3),),
        "planets 0.3 mrad": (GearHarmonics(once=0.0, twice=0.0, between=0.3e-3),),
        "coupling slips by 0.02 %": (SlippingCoupling(2e-4),),
        "low-pass 94 Hz": (LowPass(94.0),),
        "low-pass 44 Hz": (LowPass(44.0),),
        "low-pass 21 Hz": (LowPass(21.0),),
        "low-pass 10 Hz": (LowPass(10.0),),
        "low-pass 21 Hz 2nd order": (LowPass(21.0, 2),),
        "low-pass 10 Hz 2nd order": (LowPass(10.0, 2),),
        "gravity 9.781": (LocalGravity(9.781),),
        "gravity 9.832": (LocalGravity(9.832),),
        "warm-up 2 mg": (WarmUp(2e-3),),
        "warm-up 5 mg": (WarmUp(5e-3),),
        "warm-up 5 mg and 0.5 %": (WarmUp(5e-3, scale=5e-3),),
        "bias walk 0.5 mg/min": (BiasWalk(0.5e-3),),
        "nonlinearity 0.1 %": (Nonlinearity(1e-3),),
        "nonlinearity 0.5 %": (Nonlinearity(5e-3),),
        "digits 16 mg": (CoarseDigits(16e-3),),
        "vibration 0.5 m/s^2": (Vibration(0.5),),
        "clock late 80 ms": (SuClock(0.08),),
        "clock late 100 ms": (SuClock(0.1),),
        "clock late 170 ms": (SuClock(0.17),),
        "clock late 2 s": (SuClock(2.0),),
        "clock drift 100 ppm": (SuClock(drift=100e-6),),
        "clock drift 300 ppm": (SuClock(drift=300e-6),),
        "clock drift 1000 ppm": (SuClock(drift=1000e-6),),
        "clock drift 3300 ppm": (SuClock(drift=3300e-6),),
        "clocks of their own": (SuClock(0.1, 300e-6, common=False),),
        "clock slewed by 5 ms": (UnsteadyClock(5e-3),),
        "clock stepped by 60 ms": (UnsteadyClock(0.0, stepped=0.06),),
        "publishers 100 ms apart": (SecondPublisher(0.1, 300e-6),),
        "held 2 times": (Held(2),),
        "held 5 times": (Held(5),),
        "positions held 4 times": (HeldPositions(4),),
        "positions on change": (OnChange(),),
        "positions 3 ms apart": (ReadInTurn(3e-3),),
        "positions averaged over 100 ms": (SmoothedPositions(0.1),),
        "glitches 0.1 %": (Glitches(1e-3),),
        "spikes 0.1 %": (Spikes(1e-3),),
        "lost 2 %": (Lost(0.02),),
        "bursts of 4, 5 % lost": (Bursts(4, lost=0.05),),
        "stalls of 0.25 s": (Stalls(5.0, 0.25),),
        "base carried by 8 mrad": (),
        "base sways by 5 mrad": (),
        "eight at once": (
            ElasticGears(28e3, 14e3),
            _gear(0.5),
            LowPass(44.0),
            LocalGravity(9.80),
            WarmUp(1e-3),
            Nonlinearity(1e-3),
            SuClock(0.02, 100e-6),
            Lost(0.01),
        ),
    }
)
"""Defects of every row, by its name."""
BASES: Mapping[str, Tilting] = MappingProxyType(
    {"base carried by 8 mrad": Tilting(8e-3), "base sways by 5 mrad": Tilting(5e-3, 5.0)}
)
"""How the base tilts by itself in some of the rows."""
