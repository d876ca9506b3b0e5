"""Logs in and out: files of any format to streams of positions and specific forces, and back."""
