"""Stiff and extreme cases: scenes that are stable, refused beforehand, or detected during the run.

`scenes` and `own_scenes` draw them, `limits` compares predicted and true time-step limits and has the long runs,
`command` runs, judges and presents all.
"""
