"""Logs in and out: files of any format to streams of joint positions and specific forces, and back."""
