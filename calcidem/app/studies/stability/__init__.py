"""Stiff and extreme cases: which scenes are stable, refused beforehand, or found out during the run.

`scenes` and `own_scenes` draw them, `verdict` runs and judges them, `limits` compares predicted and true time-step
limits, `endurance` has the long runs, `report` shows, `command` does it all.
"""
