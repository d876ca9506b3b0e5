"""Simulated recordings: robots of known URDF, skins, motion, sensors, and the truth behind them."""

from skin2urdf.simulation.motion_settings import MotionSettings
from skin2urdf.simulation.robots import RobotSpec, load_robot, robot_names
from skin2urdf.simulation.sensors import GRADES, SensorGrade
from skin2urdf.simulation.settings import PLANTS, PlantSettings, SimulationSettings
from skin2urdf.simulation.simulate import Simulation, Truth, simulate

__all__ = [
    "GRADES",
    "PLANTS",
    "MotionSettings",
    "PlantSettings",
    "RobotSpec",
    "SensorGrade",
    "Simulation",
    "SimulationSettings",
    "Truth",
    "load_robot",
    "robot_names",
    "simulate",
]
