"""Stiff and extreme cases: scenes that are stable, refused beforehand, or detected during the run.

`scenes` and `own_scenes` draw them, `verdict` runs and judges them, `limits` compares predicted and true time-step
limits, `endurance` has the long runs, `report` presents, `command` runs all.
"""
