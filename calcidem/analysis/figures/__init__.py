"""Figures: pure functions from data to `matplotlib.figure.Figure`, in one style.

`registry.CAMPAIGN_FIGURES` lists those that a campaign has, each with file name, title and caption;
`velocities` also draws the studies of `calcidem.app.studies.sensitivity`; `style.save` writes PNG, SVG and PDF.
"""
