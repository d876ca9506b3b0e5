"""Closed-form starts, inwards and outwards."""
