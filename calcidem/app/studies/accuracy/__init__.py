"""Error against run time: what each numerical setting costs and how far it moves a result.

`settings` lists them, `reference` gives the truth, `study.run_study` measures, `questions` has those with a truth of
their own, `report` shows, `command` does it all.
"""
