"""Draw the gallery from stored data: `python docs/gallery/make_gallery.py [--all]`.

The build of the site draws the figures of the campaign in the same manner, and fails if one of them is no longer the
file beside this program (scripts/docs_site.py). With ``--all`` the figures of the studies, which simulate for minutes,
and pictures of the report, which need a browser, are renewed as well; the build does not make these.
"""

import argparse
import hashlib
import json
import sys
import tempfile
import textwrap
from itertools import chain
from pathlib import Path

from calcidem.analysis.figures.registry import CAMPAIGN_FIGURES
from calcidem.analysis.figures.style import reduce_colours, render
from calcidem.analysis.figures.velocities import STUDY_FIGURES
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.cli.exchange import import_command
from calcidem.app.report.page import write_report
from calcidem.app.studies.sensitivity import run_studies

FOLDER = Path(__file__).parent
sys.path.append(str(FOLDER.parent / "reproduction"))
from figures import PAPER_FIGURES  # noqa: E402 - a program beside the pages on the paper

PAPER = FOLDER.parents[1] / "calcidem" / "app" / "config" / "presets" / "paper.nc"
QUICK = FOLDER / "quick.db"
"""Campaign of the preset `quick`, with sections: that of the paper is shipped without."""

_OF_QUICK = ("measurement", "signals", "dispersion", *(entry.name for entry in PAPER_FIGURES))  # need sections
FIGURES = (*CAMPAIGN_FIGURES, *PAPER_FIGURES)
_LINE = 120  # longest line of a page

SCREENS = {
    "report_1280": (1280, "light", False),
    "report_1280_dark": (1280, "dark", True),
    "report_390": (390, "light", False),
    "report_390_dark": (390, "dark", True),
}
"""Width in pixels, colours, and whether a cell is shown instead of the top, for each picture of the report."""


def main() -> None:
    """Draw the figures, and write the page that shows them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--all", action="store_true")
    pictures = drawn_figures() | (drawn_studies() if parser.parse_args().all else {})
    for name, picture in pictures.items():
        (FOLDER / f"{name}.png").write_bytes(picture)
    (FOLDER / "drawn_from.json").write_text(json.dumps(stored_data(), indent=1) + "\n", encoding="utf-8")
    (FOLDER / "README.md").write_text(gallery_page(), encoding="utf-8")


def drawn_figures(names: tuple[str, ...] = ()) -> dict[str, bytes]:
    """Give the pictures of a campaign by name, by default all."""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        paper = f"{folder}/paper.db"
        import_command(PAPER, paper)
        with open_campaign(paper) as whole, open_campaign(QUICK) as quick:
            analyses = whole.analyse(), quick.analyse()
            for entry in (entry for entry in FIGURES if entry.name in names or not names):
                figure = entry.draw(analyses[entry.name in _OF_QUICK])
                found[entry.name] = render(figure, "png", colours=256 if entry.pictorial else None)
    return found


def drawn_studies() -> dict[str, bytes]:
    """Run the studies and give their figures, and pictures of a report with them if there is a browser."""
    sys.path.append(str(FOLDER.parents[1] / "tests"))
    from chromium import find_chromium, open_chromium  # noqa: PLC0415 - a helper of the tests

    studies = run_studies(QUICK)
    found = {
        entry.name: render(entry.draw(study), "png")
        for varied, study in studies.items()
        for entry in STUDY_FIGURES[varied]
    }
    program = find_chromium()
    if program is None:
        return found
    with tempfile.TemporaryDirectory() as folder, open_chromium(program, Path(folder)) as browser:
        paper, picture = f"{folder}/paper.db", Path(folder) / "picture.png"
        import_command(PAPER, paper)
        page = write_report(paper, Path(folder) / "report.html", studies=studies)
        for name, (width, look, shows_cell) in SCREENS.items():
            browser.show(page, width, 1500, dark=look == "dark", anchor="#seed=1&content=5" if shows_cell else "")
            if shows_cell:
                browser.wait_for("document.getElementById('record') && scrollY > 0")
            browser.photograph(picture)
            found[name] = reduce_colours(picture.read_bytes())
    return found


def stored_data() -> dict[str, str]:
    """Give the SHA-256 of each file that figures are drawn from, by its name."""
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in (PAPER, QUICK)}


def gallery_page(*, captions: bool = False) -> str:
    """Give the page of the gallery, with a caption below each figure if asked."""
    lines = [
        "# Gallery",
        "",
        *textwrap.wrap(
            "Figures of the campaign `paper`; those that need signals are of the preset `quick`. "
            "`python docs/gallery/make_gallery.py` draws them.",
            _LINE,
        ),
        "",
    ]
    for entry in chain(FIGURES, *STUDY_FIGURES.values()):
        lines += [f"## {entry.title}", "", f"![Figure]({entry.name}.png)", ""]  # as the heading says
        lines += [textwrap.fill(entry.caption, _LINE), ""] if captions else []
    lines += ["## The report", "", "At two widths: the first screen and one of the cells.", ""]
    lines += [f"![Report, {width} pixels wide, {look}]({name}.png)" for name, (width, look, _) in SCREENS.items()]
    return "\n".join(lines).rstrip() + "\n"


if __name__ == "__main__":
    main()
