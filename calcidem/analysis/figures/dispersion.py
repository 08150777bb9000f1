"""Picture of the dispersion of shear waves: phase velocity against frequency at each content."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calcidem.analysis.dispersion import ContentDispersion
from calcidem.analysis.figures.style import BLACK, GREEN, KHZ, VERMILION, apply_style, letter_panels, new_figure

_PANELS_ABREAST = 2
_NARROW = 0.45, 2.2
"""Displayed range of velocities over the median Vs, if all results lie in it."""


@apply_style
def draw_dispersion(contents: Sequence[ContentDispersion]) -> Figure:
    """Draw power over frequency and phase velocity, the phase velocity with its error, and the long-wave limit."""
    lines = -(-len(contents) // _PANELS_ABREAST)
    figure = new_figure(height=0.7 + 2.1 * lines)
    panels = figure.subplots(lines, _PANELS_ABREAST, squeeze=False).ravel()
    for axes, shown in zip(panels, contents, strict=False):
        _draw_content(axes, shown)
    letter_panels(panels[: len(contents)])
    for axes in panels[len(contents) :]:
        axes.set_axis_off()
    figure.supxlabel("frequency (kHz)", fontsize=9)
    figure.supylabel("phase velocity (m/s)", fontsize=9)
    labelled = max((axes.get_legend_handles_labels() for axes in panels), key=lambda found: len(found[1]))
    figure.legend(*labelled, loc="outside upper center", ncols=2)
    return figure


def _draw_content(axes: Axes, shown: ContentDispersion) -> None:
    """Draw the spectrum of one content and its dispersion."""
    found = shown.found
    axes.grid(visible=False)
    axes.pcolormesh(
        found.frequency * KHZ, found.velocity, found.power.T, cmap="Blues", vmin=0.0, vmax=1.0, rasterized=True
    )
    axes.errorbar(
        found.frequency * KHZ,
        found.phase_velocity,
        yerr=found.standard_error,
        fmt="o-",
        color=BLACK,
        markersize=2.5,
        linewidth=0.8,
        label="phase velocity and its standard error",
    )
    axes.errorbar(
        *([0.0], [found.long_wave]),
        yerr=[found.long_wave_error],
        fmt="D",
        color=VERMILION,
        markersize=4.5,
        capsize=2,
        clip_on=False,
        zorder=5,
        label="long-wave limit",
    )
    axes.axhline(shown.vs, color=VERMILION, linewidth=0.9, linestyle=":", label="median Vs")
    if np.isfinite(shown.static):
        axes.axhline(shown.static, color=GREEN, linewidth=0.9, linestyle="--", label="static speed (median)")
    reached = [*found.phase_velocity, found.long_wave, shown.vs]
    low, high = (factor * shown.vs for factor in _NARROW)
    axes.set_ylim(min(low, 0.9 * min(reached)), max(high, 1.1 * max(reached)))
    axes.set_xlim(0.0, found.frequency[-1] * KHZ)
    axes.set_title(f"{shown.content:g} % ({found.samples} samples)")
