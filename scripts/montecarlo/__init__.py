"""Repeated recordings: are the errors of a calibration as large as it states?"""
