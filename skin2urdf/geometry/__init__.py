"""Rotations and rigid transforms, vectorised."""
