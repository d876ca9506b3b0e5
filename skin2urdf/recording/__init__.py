"""Logs in and out: MCAP files to streams of joint positions and specific forces, and back."""
