"""Draw the gallery from a campaign: `python docs/gallery/make_gallery.py CAMPAIGN.db`."""

import argparse
import shutil
import subprocess
import tempfile
from pathlib import Path

from calcidem.analysis.campaign_analysis import CampaignAnalysis
from calcidem.analysis.figures.registry import CAMPAIGN_FIGURES
from calcidem.analysis.figures.sensitivity import STUDY_FIGURES
from calcidem.analysis.figures.style import render
from calcidem.app.report import write_report
from calcidem.app.report.page import key_facts
from calcidem.app.report.provenance import CHOSEN, flat_parameters, value_text
from calcidem.app.studies.frequency_and_damping import run_studies
from calcidem.storage.campaign import open_stored_campaign

FOLDER = Path(__file__).parent
SCREENS = {390: 1500, 1280: 1500}
"""Widths and heights of the pictures of the report, in pixels."""


def main() -> None:
    """Draw all figures, take pictures of the report, and write the page that shows them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("database")
    database = parser.parse_args().database
    studies = run_studies(database)
    with open_stored_campaign(database) as campaign:
        analysis = CampaignAnalysis(campaign)
        shown = [(entry.name, entry.title, entry.caption, entry.draw(analysis)) for entry in CAMPAIGN_FIGURES]
        facts, config = key_facts(analysis), flat_parameters(campaign.config)
    shown += [(e.name, e.title, e.caption, e.draw(studies[e.study])) for e in STUDY_FIGURES]
    pictorial = {entry.name for entry in CAMPAIGN_FIGURES if entry.pictorial}
    for name, _, _, figure in shown:
        (FOLDER / f"{name}.png").write_bytes(render(figure, "png", colours=256 if name in pictorial else None))
    photograph(database, studies)
    parameters = ", ".join(f"`{key}` = {value_text(config[key])}" for key in CHOSEN if key in config)
    lines = [
        "# Gallery",
        "",
        "Every figure of one campaign, drawn by `make_gallery.py` in this folder.",
        "",
        "; ".join(f"{term}: {value}" for term, value in facts) + ".",
        "",
        f"Parameters that were calibrated or chosen: {parameters}.",
        "",
    ]
    for name, title, caption, _ in shown:
        lines += [f"## {title}", "", f"![{title}]({name}.png)", "", caption, ""]
    if (FOLDER / "report_390.png").exists():
        lines += ["## The report", "", "On a desk, and on a phone.", ""]
        lines += [f"![Report, {width} pixels wide](report_{width}.png)" for width in reversed(SCREENS)]
    (FOLDER / "README.md").write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


def photograph(database: str, studies: dict) -> None:  # type: ignore[type-arg] - of datasets, which this script never opens
    """Take pictures of the top of the report, if there is a browser."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        return
    with tempfile.TemporaryDirectory() as folder:
        page = write_report(database, Path(folder) / "report.html", studies=studies)
        for width, height in SCREENS.items():
            picture = Path(folder) / f"{width}.png"
            options = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
            size = f"--window-size={width},{height}"
            subprocess.run(  # noqa: S603 - the browser that was looked up, on a page written just above
                [browser, *options, size, f"--screenshot={picture}", page.as_uri()], check=True, capture_output=True
            )
            shutil.copy(picture, FOLDER / f"report_{width}.png")


if __name__ == "__main__":
    main()
