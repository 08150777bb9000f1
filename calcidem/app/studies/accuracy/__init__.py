"""Error over run time: cost of each numerical setting, and its effect on the result.

`settings` lists them, `study` measures each cell's reference and the error of every setting, `questions` has the tables
with their own reference, `report` runs all and presents it.
"""
