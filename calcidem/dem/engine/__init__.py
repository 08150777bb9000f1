"""Scenes and their states: starting, advancing, readout."""
