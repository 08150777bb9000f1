"""Comparison of stored campaigns."""

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

import pandas as pd
import xarray as xr

from calcidem.analysis.comparison import compare_velocities
from calcidem.app.campaign.opened import Campaign, open_campaign
from calcidem.storage.errors import QueryError
from calcidem.storage.records.canonical import config_difference

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, eq=False)
class CampaignComparison:
    """Mean and scatter of Vs of several campaigns, and their differences from the first.

    Attributes
    ----------
    table
        Numbers and intervals along (campaign, content, bound), in m/s:
        `calcidem.analysis.comparison.compare_velocities`.
    differing
        For each further campaign the differences of its configuration from the first, one line for each key.
    """

    table: xr.Dataset
    differing: Mapping[str, tuple[str, ...]]

    def to_dataframe(self) -> pd.DataFrame:
        """Return a table with a row for each campaign and content, and separate columns for the ends of intervals."""
        flat = self.table.drop_vars("bound")
        for name in [str(name) for name in flat.data_vars if str(name).endswith("_interval")]:
            low, high = (flat[name].isel(bound=place) for place in (0, 1))
            flat = flat.drop_vars(name).assign({f"{name}_low": low, f"{name}_high": high})
        whole = {"n": "Int64", "pairs": "Int64"}
        return flat.to_dataframe().reset_index().astype(whole)

    def draw(self, ax: "Axes | None" = None) -> "Figure":
        """Draw means, scatter and differences, and return the whole figure.

        The two panels replace ``ax``, axes of a figure made by `plt.subplots`; None for a new figure.
        """
        from calcidem.analysis.figures.style import drawn_in  # noqa: PLC0415 - matplotlib takes half a second
        from calcidem.analysis.figures.velocities import draw_comparison  # noqa: PLC0415

        with drawn_in(ax):
            return draw_comparison(self.table)

    def _repr_html_(self) -> str:
        """Table for notebooks."""
        columns = ["campaign", "content", "n", "mean", "standard_deviation", "difference", "paired_difference"]
        lines = [f"<p>{escape(name)}: {escape('; '.join(texts))}</p>" for name, texts in self.differing.items()]
        table = self.to_dataframe()[columns].to_html(index=False, float_format=lambda value: f"{value:.1f}")
        return "".join([*lines, table])


def compare(campaigns: Sequence[Campaign | str | os.PathLike[str]], level: float = 0.95) -> CampaignComparison:
    """Compare campaigns with the first of them: means, scatter and differences of Vs, with intervals at a level.

    They are opened campaigns, files, or database URLs. `QueryError` for fewer than two, `StoreError` if a database
    cannot be read or has several campaigns.

    Examples
    --------
    >>> comparison = compare(["quick.db", "quick.db"])  # with itself: no difference at all
    >>> float(comparison.table.paired_difference[1].max())
    0.0
    """
    if len(campaigns) <= 1:
        raise QueryError(f"{len(campaigns)} campaigns are given.", "Give two or more to compare.")
    with ExitStack() as stack:
        opened = [one if isinstance(one, Campaign) else stack.enter_context(open_campaign(one)) for one in campaigns]
        names = _label_apart(opened)
        velocities = {name: campaign.vs() for name, campaign in zip(names, opened, strict=True)}
        first, *others = (campaign.record.config for campaign in opened)
    differing = {name: tuple(config_difference(first, other)) for name, other in zip(names[1:], others, strict=True)}
    return CampaignComparison(compare_velocities(velocities, level), differing)


def _label_apart(campaigns: Sequence[Campaign]) -> list[str]:
    """Label campaigns by name; add files to equal names, and numbers to equal files."""
    labels = [campaign.record.name for campaign in campaigns]
    counts = Counter(labels)
    for place, campaign in enumerate(campaigns):
        path = campaign.store.address.path
        if counts[labels[place]] > 1 and path is not None:
            labels[place] = f"{labels[place]} ({path.name})"
    counts = Counter(labels)
    return [f"{label} [{place + 1}]" if counts[label] > 1 else label for place, label in enumerate(labels)]
