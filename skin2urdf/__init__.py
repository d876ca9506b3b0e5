"""From a ROS 2 bag of joint states and accelerometers to the URDF of the robot that carried them.

from skin2urdf import calibrate, save

calibration = calibrate("log.mcap")
save(calibration, "robot.urdf")
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"
__all__ = ["Calibration", "CalibrationSettings", "__version__", "calibrate", "compare", "save"]

if TYPE_CHECKING:
    from skin2urdf.calibration.pipeline import calibrate
    from skin2urdf.calibration.result import Calibration
    from skin2urdf.calibration.settings import CalibrationSettings
    from skin2urdf.output import save
    from skin2urdf.urdf.compare import compare

_HOMES = {
    "Calibration": "skin2urdf.calibration.result",
    "CalibrationSettings": "skin2urdf.calibration.settings",
    "calibrate": "skin2urdf.calibration.pipeline",
    "compare": "skin2urdf.urdf.compare",
    "save": "skin2urdf.output",
}


def __getattr__(name: str) -> Any:
    """Import public names when they are first used; SciPy and Pinocchio take a while."""
    if name in _HOMES:
        from importlib import import_module

        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
