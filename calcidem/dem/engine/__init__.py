"""Scenes, their states, and how they are advanced and read."""
