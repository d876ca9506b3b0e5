"""Robots as they stand in space: solids, uncertainty and open directions, for any renderer."""
