"""The way from logs to a calibrated robot."""
