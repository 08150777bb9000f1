"""Distributed Monte-Carlo campaigns of discrete-element simulations of calcite-cemented sand."""
