"""The only place of the version: the wheel, the command and all files that name it take it from here."""

__version__ = "1.0.0"
