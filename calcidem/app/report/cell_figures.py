"""Figures of one sample: cement, path and signals."""

import os
from contextlib import suppress
from pathlib import Path

from calcidem.analysis.campaign_analysis import UnavailableError
from calcidem.analysis.figures.style import save
from calcidem.app.campaign.opened import open_campaign


def draw_cell(
    database: str | os.PathLike[str], seed: int, content: float, folder: Path, *, campaign_name: str | None = None
) -> list[Path]:
    """Draw one cell into a folder as far as it has what the figures need; return the files written."""
    files: list[Path] = []
    with open_campaign(database, campaign_name) as campaign:
        plots = campaign.plot
        for name, draw in {"cement": plots.cement, "path": plots.path, "signals": plots.signal}.items():
            with suppress(UnavailableError):
                files += save(draw(seed=seed, content=content), folder, f"seed{seed}_content{content:g}_{name}")
    return files
