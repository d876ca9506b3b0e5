"""An IMU YAML as kalibr writes it: noise, errors, delay and place of every SU."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from skin2urdf.errors import UsageError
from skin2urdf.export.source import ExportedSu, Source, T_su_link
from skin2urdf.export.yaml_text import yaml_text


def to_imu(source: Source) -> str:
    """SUs as kalibr's set of IMUs, ``imu0`` and on.

    Args:
        source: what to export, with its JSON.

    Returns:
        The text of the file.

    Raises:
        UsageError: there is no JSON beside the URDF, which alone knows the sensors, or no SU.
    """
    if source.document is None:
        raise UsageError(
            f"no JSON of this very file lies beside {source.path}, and a URDF knows nothing of "
            "sensors' noise and errors",
            "export from the URDF and JSON that `skin2urdf calibrate` wrote",
        )
    if not source.sus:
        raise UsageError(f"{source.path} has no SUs", "give a URDF that skin2urdf calibrated")
    return yaml_text(
        {f"imu{n}": _imu(su) for n, su in enumerate(source.sus)},
        [
            *source.made_from,
            "T_i_b maps coordinates of the link (body) into those of the SU (i); null where the "
            "log does not tell the SU's place",
            "a reading is M f + bias with M symmetric; what was felt at t bears the stamp "
            "t - time_offset",
            "densities are those of white noise; what is null was not told by the log: take it "
            "from the data sheet",
        ],
    )


def _imu(su: ExportedSu) -> dict[str, Any]:
    """One SU in kalibr's keys, and who it is."""
    facts = su.facts or {}
    noise, rate = facts.get("noise_density"), facts.get("rate")
    latency = facts.get("latency")
    M = np.eye(3) + np.diag(facts["scale"])
    yz, xz, xy = facts["cross_yz_xz_xy"]
    M += np.array([[0.0, xy, xz], [xy, 0.0, yz], [xz, yz, 0.0]])
    turning = facts.get("gyro") or {}
    gyro = _gyro(turning, facts.get("gyro_noise_density")) if turning.get("used") else {}
    return {
        "T_i_b": None if su.position_open else T_su_link(su).tolist(),
        "accelerometers": {"M": M.tolist(), "bias": list(facts["bias"])},
        "accelerometer_noise_density": None if noise is None else float(np.mean(noise)),
        "accelerometer_random_walk": facts.get("bias_random_walk"),
        **gyro,
        "model": "scale-misalignment",
        "rostopic": facts.get("topic"),
        "time_offset": None if latency is None else -float(latency),
        "update_rate": None if rate is None else round(float(rate), 6),
        "frame_id": su.known_as,
        "body": su.joint.parent,
    }


def _gyro(facts: Mapping[str, Any], density: float | None) -> dict[str, Any]:
    """What was found of a gyroscope that counted; of several logs the mean bias."""
    xy, xz, yx, yz, zx, zy = facts["misalignment"]
    M = np.diag(1.0 + np.array(facts["scale"]))
    M += np.array([[0.0, xy, xz], [yx, 0.0, yz], [zx, zy, 0.0]])
    bias = np.reshape(facts["bias"], (-1, 3)).mean(axis=0)
    return {
        "gyroscopes": {"M": M.tolist(), "bias": bias.tolist()},
        "gyroscope_noise_density": density,
        "gyroscope_random_walk": None,
    }
