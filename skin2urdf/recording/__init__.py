"""Logs in and out: files of any format to streams of positions and readings, and back."""
