"""Configuration, command line and report: the part of calcidem that knows all the others."""
