"""Rotations, rigid transforms with their one order of twists, extended DH numbers, and units."""
