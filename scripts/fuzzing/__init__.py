"""Logs that are damaged in every way, and what the commands make of them."""
