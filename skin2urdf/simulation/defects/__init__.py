"""What real robots have and ideal ones have not, each as physics of its own and with a size."""

from skin2urdf.simulation.defects.front_end import LowPass
from skin2urdf.simulation.defects.gears import (
    Backlash,
    ElasticGears,
    GearHarmonics,
    SlippingCoupling,
)
from skin2urdf.simulation.defects.messages import (
    Bursts,
    Glitches,
    Held,
    HeldPositions,
    Lost,
    OnArrival,
    OnChange,
    OwnRates,
    ReadInTurn,
    SecondPublisher,
    SmoothedPositions,
    Spikes,
    Stalls,
    SuClock,
    UnsteadyClock,
)
from skin2urdf.simulation.defects.readings import BiasWalk, CoarseDigits, Nonlinearity, WarmUp
from skin2urdf.simulation.defects.records import Defect
from skin2urdf.simulation.defects.structure import LinkFlex, YieldingBase
from skin2urdf.simulation.defects.vibration import Vibration
from skin2urdf.simulation.defects.world import LocalGravity

__all__ = [
    "Backlash",
    "BiasWalk",
    "Bursts",
    "CoarseDigits",
    "Defect",
    "ElasticGears",
    "GearHarmonics",
    "Glitches",
    "Held",
    "HeldPositions",
    "LinkFlex",
    "LocalGravity",
    "Lost",
    "LowPass",
    "Nonlinearity",
    "OnArrival",
    "OnChange",
    "OwnRates",
    "ReadInTurn",
    "SecondPublisher",
    "SlippingCoupling",
    "SmoothedPositions",
    "Spikes",
    "Stalls",
    "SuClock",
    "UnsteadyClock",
    "Vibration",
    "WarmUp",
    "YieldingBase",
]
