"""Configuration, campaigns, studies, command line, report and live page: uses all other parts of calcidem."""
