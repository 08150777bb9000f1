"""Error against run time: what each numerical setting costs and how far it moves a result.

`study.run_study` measures, `table` and `figure` show, `command.accuracy` is the command.
"""
