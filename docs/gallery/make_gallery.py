"""Draw the gallery from a campaign: `python docs/gallery/make_gallery.py CAMPAIGN.db`."""

import argparse
import sys
import tempfile
import textwrap
from pathlib import Path

from calcidem.analysis.figures.registry import CAMPAIGN_FIGURES
from calcidem.analysis.figures.sensitivity import STUDY_FIGURES
from calcidem.analysis.figures.style import reduce_colours, render
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.report.page import key_facts, write_report
from calcidem.app.studies.frequency_and_damping import run_studies

FOLDER = Path(__file__).parent
sys.path.append(str(FOLDER.parents[1] / "tests"))
from chromium import find_chromium, open_chromium  # noqa: E402 - a helper of the tests

_LINE = 120  # longest line of a page

SCREENS = {
    "report_1280": (1280, "light", False),
    "report_1280_dark": (1280, "dark", True),
    "report_390": (390, "light", False),
    "report_390_dark": (390, "dark", True),
}
"""Width in pixels, colours, and whether a cell is shown instead of the top, for each picture of the report."""


def main() -> None:
    """Draw all figures, take pictures of the report, and write the page that shows them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("database")
    database = parser.parse_args().database
    studies = run_studies(database)
    with open_campaign(database) as campaign:
        analysis = campaign.analyse()
        shown = [(entry.name, entry.title, entry.caption, entry.draw(analysis)) for entry in CAMPAIGN_FIGURES]
        facts = key_facts(analysis)
    shown += [(e.name, e.title, e.caption, e.draw(studies[e.study])) for e in STUDY_FIGURES]
    pictorial = {entry.name for entry in CAMPAIGN_FIGURES if entry.pictorial}
    for name, _, _, figure in shown:
        (FOLDER / f"{name}.png").write_bytes(render(figure, "png", colours=256 if name in pictorial else None))
    photograph(database, studies)
    lines = [
        "# Gallery",
        "",
        "Every figure of one campaign, drawn by `make_gallery.py` in this folder.",
        "",
        textwrap.fill("; ".join(f"{term}: {value}" for term, value in facts) + ".", _LINE),
        "",
    ]
    for name, title, caption, _ in shown:
        lines += [f"## {title}", "", f"![{title}]({name}.png)", "", textwrap.fill(caption, _LINE), ""]
    if (FOLDER / "report_390.png").exists():
        lines += ["## The report", "", "At two widths: the first screen and one of the cells.", ""]
        lines += [f"![Report, {width} pixels wide, {look}]({name}.png)" for name, (width, look, _) in SCREENS.items()]
    (FOLDER / "README.md").write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


def photograph(database: str, studies: dict) -> None:  # type: ignore[type-arg] - of datasets, which this script never opens
    """Take pictures of the report, if there is a browser."""
    program = find_chromium()
    if program is None:
        return
    with open_campaign(database) as campaign:
        key = next(campaign.select(status="done", content=5.0)).key
    part = f"#seed={key.seed}&content={key.content:g}"
    with tempfile.TemporaryDirectory() as folder, open_chromium(program, Path(folder)) as browser:
        page = write_report(database, Path(folder) / "report.html", studies=studies)
        for name, (width, look, shows_cell) in SCREENS.items():
            browser.show(page, width, 1500, dark=look == "dark", anchor=part if shows_cell else "")
            if shows_cell:
                browser.wait_for("document.getElementById('record') && scrollY > 0")
            browser.photograph(FOLDER / f"{name}.png")
            (FOLDER / f"{name}.png").write_bytes(reduce_colours((FOLDER / f"{name}.png").read_bytes()))


if __name__ == "__main__":
    main()
