"""Picture of a signal that gave no velocity: what arrived, and why none of its tops was read."""

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calcidem.analysis.figures.style import BLUE, GREY, MS, ORANGE, SKY, VERMILION, apply_style, new_figure
from calcidem.analysis.unread_signal import SignalTop, UnreadSignal

_LINE = 0.16  # inches of a line below the picture
_WIDEST = 96  # characters of such a line
_ROOM = 1.5  # top of the picture over the largest value: numbers and names of windows stand there


@apply_style
def draw_unread_signal(signal: UnreadSignal) -> Figure:
    """Draw a signal with its windows, and its tops with a number each, which is explained below."""
    lines = [*textwrap.wrap(f"No velocity: {signal.reason}.", _WIDEST), *_explanations(signal.tops)]
    lines += textwrap.wrap(_legend_of_windows(signal), _WIDEST)
    picture, text = 2.9, 0.1 + _LINE * len(lines)
    figure = new_figure(height=picture + text)
    axes, below = figure.subplots(2, 1, height_ratios=(picture, text))
    axes.set_title(signal.title)
    _draw_windows(axes, signal)
    _draw_lines(axes, signal)
    below.set_axis_off()
    below.text(0.0, 1.0, "\n".join(lines), va="top", fontsize=7.5, linespacing=1.35, transform=below.transAxes)
    return figure


def _legend_of_windows(signal: UnreadSignal) -> str:
    """What is shaded."""
    slowest, fastest = signal.possible
    text = f"Hatched: a wave that comes then is not slower than {fastest:g} m/s, or not faster than {slowest:g} m/s."
    if signal.expected is None:
        return text
    slow, fast = (f"{velocity:.0f}" for velocity in signal.expected)
    span = slow if slow == fast else f"{slow} to {fast}"
    return f"{text} S?: {span} m/s are expected. P?: {signal.faster[0]:g} to {signal.faster[1]:g} times as fast."


def _explanations(tops: Sequence[SignalTop]) -> list[str]:
    """What each number stands for, in lines."""
    entries = [
        f"{number}  {top.time * MS:.4g} ms, {top.velocity:.0f} m/s: {top.verdict}"
        for number, top in enumerate(tops, start=1)
    ]
    return [line for entry in entries for line in textwrap.wrap(entry, _WIDEST, subsequent_indent="    ")]


def _draw_lines(axes: Axes, signal: UnreadSignal) -> None:
    """Draw sent, received and smoothed signal over their largest values, and the numbered tops."""
    time, finite = signal.time * MS, np.isfinite(signal.received)
    scale = float(np.abs(signal.received[finite]).max(initial=0.0)) or 1.0
    axes.axhline(0, color=GREY, linewidth=0.6)
    axes.fill_between(time, signal.sent / signal.sent.max(), color=GREY, alpha=0.35, linewidth=0, label="sent")
    axes.plot(time, signal.received / scale, color=SKY, linewidth=2.8, alpha=0.5, label="received")
    axes.plot(time, signal.smooth / scale, color=BLUE, linewidth=1.3, label="smoothed")
    for number, top in enumerate(signal.tops, start=1):
        height, colour = top.height / scale, VERMILION if top.main else GREY
        axes.plot(top.time * MS, height, "o", color=colour, markersize=4.5, markeredgecolor="white", zorder=5)
        offset = (0, 5 + 9 * (number % 2))  # neighbours do not hide each other
        axes.annotate(
            str(number),
            (top.time * MS, height),
            xytext=offset,
            textcoords="offset points",
            ha="center",
            fontsize=8.0,
            fontweight="bold" if top.main else "normal",
            color=VERMILION if top.main else "#50565b",
        )
    lowest = float((signal.received[finite] / scale).min(initial=0.0))
    axes.set_xlim(0, time[-1])
    axes.set_ylim(min(-0.15, 1.1 * lowest), _ROOM)
    axes.set_xlabel("time (ms)")
    axes.set_ylabel("signal / its largest value")
    axes.legend(loc="upper right", ncols=3, bbox_to_anchor=(1.0, 1.13), borderaxespad=0.0)


def _draw_windows(axes: Axes, signal: UnreadSignal) -> None:
    """Shade where no travel time is possible, and where P and S wave are expected."""

    def moment(velocity: float) -> float:
        return (signal.sent_peak + signal.distance / velocity) * MS

    end = float(signal.time[-1]) * MS
    slowest, fastest = signal.possible
    for begin, stop in ((0.0, moment(fastest)), (moment(slowest), end)):
        if begin < min(stop, end):
            axes.axvspan(begin, min(stop, end), facecolor="none", edgecolor="#c9cdd1", hatch="////", linewidth=0)
    if signal.expected is None:
        return
    slow, fast = signal.expected
    least, most = signal.faster
    for name, span, colour in (("P?", (most * fast, least * slow), ORANGE), ("S?", (fast, slow), BLUE)):
        begin, stop = moment(span[0]), min(moment(span[1]), end)
        if begin < stop:
            axes.axvspan(begin, stop, color=colour, alpha=0.12, linewidth=0)
            axes.text(0.5 * (begin + stop), 0.97 * _ROOM, name, color=colour, ha="center", va="top", fontsize=8.0)
