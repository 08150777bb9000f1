"""Version, defined only here: the wheel, the command and all other files take it from here."""

__version__ = "1.0.0"
