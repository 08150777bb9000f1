"""Exit codes of a run, made for batch systems and shell scripts."""

EXIT_COMPLETE = 0
"""Everything asked for is settled."""

EXIT_ERROR = 1
"""Something went wrong that the same command would meet again."""

EXIT_RESUMABLE = 75
"""Stopped early, all that was finished is stored, the same command continues (EX_TEMPFAIL of sysexits.h)."""
