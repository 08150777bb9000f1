"""Checks of a machine for a campaign, each by a trial."""
