"""A calibrated URDF in the formats that controllers, simulators and launch files read."""
