"""Error over run time: cost of each numerical setting, and its effect on the result.

`settings` lists them, `reference` computes the reference, `study.run_study` measures, `questions` has the results, and
the questions with their own reference, `report` presents, `command` runs all.
"""
