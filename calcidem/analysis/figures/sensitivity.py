"""Pictures of the sensitivity studies: reading method, damping and excitation frequency."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calcidem.analysis.figures.signals import METHOD_STYLES
from calcidem.analysis.figures.style import (
    BLUE,
    CONTENT_MAP,
    FIGURE_WIDTH,
    GREY,
    KHZ,
    MS,
    SEQUENCE,
    VS_LABEL,
    apply_style,
    letter_panels,
    new_figure,
)

_FREQUENCY_LABEL = "excitation frequency (kHz)"
_SHOWN_METHODS = ("peak", "first_arrival")


@apply_style
def _draw_reading_study(study: xr.Dataset) -> Figure:
    """Draw Vs from peak to peak and by first arrival against frequency (Fig. 6).

    Marks are hollow where transmitter and receiver are less than a wavelength apart.
    """
    contents = study["content"].to_numpy()
    lines = math.ceil(len(contents) / 2)
    figure = new_figure(height=0.6 + 2.1 * lines)
    panels = figure.subplots(lines, min(2, len(contents)), squeeze=False, sharex=True).ravel()
    frequency = study["frequency"].to_numpy() * KHZ
    for axes, content in zip(panels, contents, strict=False):
        for name in _SHOWN_METHODS:
            label, colour, marker = METHOD_STYLES[name]
            values = study[f"vs_{name}"].sel(content=content).transpose("seed", "frequency").to_numpy()
            axes.plot(frequency, values.T, color=colour, alpha=0.25, linewidth=0.7)
            known = np.isfinite(values).any(axis=0)
            mean = np.nanmean(values[:, known], axis=0)
            axes.plot(frequency[known], mean, color=colour, marker=marker, markersize=4, label=label)
            near = study.attrs["distance"] * frequency[known] / KHZ < mean
            axes.plot(
                frequency[known][near],
                mean[near],
                linestyle="none",
                color=colour,
                marker=marker,
                markersize=4,
                markerfacecolor="white",
                zorder=3,
            )
        axes.set_title(f"{content:g} %")
        _start_at_zero(axes)
    letter_panels(panels[: len(contents)])
    for axes in panels[len(contents) :]:
        axes.set_axis_off()
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(_SHOWN_METHODS))
    figure.supxlabel(_FREQUENCY_LABEL, fontsize=9)
    figure.supylabel(VS_LABEL, fontsize=9)
    return figure


@apply_style
def _draw_frequency_study(study: xr.Dataset) -> Figure:
    """Draw received frequency and Vs against transmitted frequency (Fig. 9)."""
    figure = new_figure(height=3.5, width=7.0)
    left, right = figure.subplots(1, 2)
    frequency = study["frequency"].to_numpy() * KHZ
    left.plot(frequency, frequency, color=GREY, linestyle=":", linewidth=1.2, label="equal")
    for place, (content, colour) in enumerate(zip(study["content"].to_numpy(), SEQUENCE, strict=False)):
        aside = frequency + 0.012 * (place - 1) * np.ptp(frequency)  # so that no curve hides another
        for axes, name, scale in ((left, "received_frequency", KHZ), (right, "vs_peak", 1.0)):
            values = study[name].sel(content=content).transpose("seed", "frequency").to_numpy() * scale
            known = np.isfinite(values).any(axis=0)
            low, high = np.nanmin(values[:, known], axis=0), np.nanmax(values[:, known], axis=0)
            mean = np.nanmean(values[:, known], axis=0)
            axes.fill_between(aside[known], low, high, color=colour, alpha=0.15, linewidth=0)
            axes.plot(aside[known], mean, color=colour, marker="o", markersize=3.5, label=f"{content:g} %")
        used = float(study["campaign_frequency"].sel(content=content)) * KHZ
        right.axvline(used + aside[0] - frequency[0], color=colour, linestyle="--", linewidth=0.8, alpha=0.8)
    letter_panels((left, right))
    for axes in (left, right):
        axes.set_xlabel(_FREQUENCY_LABEL)
        _start_at_zero(axes)
    left.set_ylabel("frequency received (kHz)")
    right.set_ylabel(VS_LABEL)
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=1 + study.sizes["content"])
    return figure


@apply_style
def _draw_damping_study(study: xr.Dataset) -> Figure:
    """Draw received signals for several damping factors (Fig. 7)."""
    contents = study["content"].to_numpy()
    factors = study["damping"].to_numpy()
    figure = new_figure(height=0.7 + 2.9 * len(contents), width=FIGURE_WIDTH + 0.4)
    panels = figure.subplots(len(contents), 2, squeeze=False, width_ratios=[2.2, 1.0])
    colours = mpl.colormaps[CONTENT_MAP](np.linspace(0.0, 0.9, len(factors)))
    for (signals, velocities), content in zip(panels, contents, strict=True):
        chosen = study.sel(content=content)
        time = chosen["time"].to_numpy() * MS
        received = chosen["received"].transpose("damping", ...).to_numpy()
        received = received / np.abs(received).max()
        step = float(np.diff(received, axis=0).max(initial=0.0)) + 0.1  # so that no curve meets its neighbour
        for place, (factor, signal, colour) in enumerate(zip(factors, received, colours, strict=True)):
            signals.plot(time, signal - step * place, color=colour, linewidth=1.2)
            signals.annotate(
                f"{factor:g}",
                (time[-1], -step * place),
                xytext=(4, 0),
                textcoords="offset points",
                va="center",
                fontsize=7.5,
                color=colour,
                annotation_clip=False,
            )
        signals.set_yticks([])
        signals.set_xlim(0, time[-1])
        signals.set_ylabel("received, by damping factor")
        signals.set_title(f"{content:g} %")
        velocities.plot(factors, chosen["vs_peak"].transpose("damping", ...), color=BLUE, marker="o", markersize=3.5)
        velocities.set_ylabel(VS_LABEL)
        _start_at_zero(velocities)
        velocities.set_xlim(0, 1.08 * factors[-1])
    letter_panels(panels.ravel())
    panels[-1, 0].set_xlabel("time (ms)")
    panels[-1, 1].set_xlabel("damping factor")
    return figure


@dataclass(frozen=True, slots=True)
class _StudyFigure:
    """A figure of a sensitivity study."""

    study: str
    """Study that it shows, "frequency" or "damping"."""
    name: str
    """File name without ending."""
    title: str
    """Title in a few words."""
    caption: str
    """Caption in sentences."""
    draw: Callable[[xr.Dataset], Figure]
    """Draws it from the result of the study."""


STUDY_FIGURES = (
    _StudyFigure(
        "frequency",
        "study_reading",
        "Peak to peak against first arrival",
        "Vs of the same samples by two methods of reading, over excitation frequency; thin lines are samples. Marks "
        "are hollow where transmitter and receiver are less than a wavelength apart, so that near-field effects "
        "spoil the reading.",
        _draw_reading_study,
    ),
    _StudyFigure(
        "frequency",
        "study_frequency",
        "Excitation frequency",
        "Frequency of the received pulse (one over twice its width at half height) and Vs over the frequency of "
        "the transmitted one, with the range over samples; dashed at the campaign's frequency. Contents are slightly "
        "offset.",
        _draw_frequency_study,
    ),
    _StudyFigure(
        "damping",
        "study_damping",
        "Local damping",
        "Signals received in one sample with several local damping factors, and the Vs read from them where one "
        "could be trusted.",
        _draw_damping_study,
    ),
)


def _start_at_zero(axes: Axes) -> None:
    """Let a vertical axis begin at zero, with some space above the data."""
    axes.set_ylim(0, 1.06 * axes.get_ylim()[1])
