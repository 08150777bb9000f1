"""Stiff and extreme cases: which scenes are stable, refused beforehand, or found out during the run.

`scenes` draws them, `verdict` runs and judges them, `limits` compares predicted and true time-step limits, `maps` walks
along one quantity at a time, `command.stability` is the command.
"""
