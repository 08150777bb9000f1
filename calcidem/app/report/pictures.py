"""The figures of a report as pictures that stand in the page itself."""

from base64 import b64encode
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import xarray as xr
from matplotlib.figure import Figure

from calcidem.analysis.campaign_analysis import CampaignAnalysis, UnavailableError
from calcidem.analysis.figures.registry import CAMPAIGN_FIGURES, CampaignFigure
from calcidem.analysis.figures.sensitivity import STUDY_FIGURES
from calcidem.analysis.figures.style import render

MEDIA_TYPES = {"svg": "image/svg+xml", "png": "image/png"}


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure in a page.

    Parameters
    ----------
    name, title, caption
        As in the registry.
    source
        The picture itself as a data URI; empty where there is none.
    inches
        Width for which its letters were chosen.
    reason
        Why there is none.
    """

    name: str
    title: str
    caption: str
    source: str = ""
    inches: float = 0.0
    reason: str = ""


def campaign_pictures(analysis: CampaignAnalysis) -> Iterator[Picture]:
    """Draw every figure that the campaign allows, in the registry's order."""
    for entry in CAMPAIGN_FIGURES:
        yield draw_picture(entry, analysis)


def draw_picture(entry: CampaignFigure, analysis: CampaignAnalysis) -> Picture:
    """Draw one figure, or say why it can't be drawn."""
    try:
        figure = entry.draw(analysis)
    except UnavailableError as error:
        return Picture(entry.name, entry.title, entry.caption, reason=str(error))
    source = data_uri(figure, "png" if entry.pictorial else "svg")
    return Picture(entry.name, entry.title, entry.caption, source, figure.get_figwidth())


def study_pictures(studies: Mapping[str, xr.Dataset]) -> Iterator[Picture]:
    """Draw the figures of the studies given, named "frequency" and "damping"."""
    for entry in STUDY_FIGURES:
        if entry.study in studies:
            figure = entry.draw(studies[entry.study])
            source = data_uri(figure, "svg")
            yield Picture(entry.name, entry.title, entry.caption, source, figure.get_figwidth())


def data_uri(figure: Figure, file_format: str) -> str:
    """Give a figure as a data URI, so that a page needs no other file."""
    return f"data:{MEDIA_TYPES[file_format]};base64,{b64encode(render(figure, file_format)).decode()}"
