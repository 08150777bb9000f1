"""Error of a configuration, which lists all its problems."""

from collections.abc import Sequence

from calcidem.dem.engine.fields import Problem as Problem  # noqa: PLC0414 - for all who raise the error


class ConfigurationError(ValueError):
    """A configuration that cannot be computed; the message lists all its problems.

    Attributes
    ----------
    source
        Origin of the configuration, such as a file name.
    problems
        All problems, at least one.
    """

    def __init__(self, source: str, problems: Sequence[Problem]) -> None:
        count = "1 problem" if len(problems) == 1 else f"{len(problems)} problems"
        lines = "".join(f"\n  {problem.message}" for problem in problems)
        super().__init__(f"{source}: {count}, nothing was computed{lines}")
        self.source = source
        self.problems = problems

    def __reduce__(self) -> tuple[type["ConfigurationError"], tuple[str, Sequence[Problem]]]:
        """Pickle with both arguments."""
        return type(self), (self.source, self.problems)
