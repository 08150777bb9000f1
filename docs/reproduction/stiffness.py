"""Print the table and draw the figure of docs/how-to/random-field.md.

`python docs/reproduction/stiffness.py DB` takes eight seeds at five contents of a campaign of the preset `paper`.
"""

import argparse
from pathlib import Path

import calcidem
from calcidem.analysis.figures.style import render

PAGE = Path(__file__).parents[1] / "how-to"
WINDOWS = (0.006, 0.012, 0.024)
CONTENTS = (0.11, 0.66, 2.55, 5.0, 9.0)


def main() -> None:
    """Compute the fields with each window."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("database")
    parser.add_argument("--seeds", type=int, default=8)
    options = parser.parse_args()
    print("| window, mm | content % | geometric mean, MPa | sd of ln G | scale along x, mm | along y, mm | unknown |")
    print("|---|---|---|---|---|---|---|")
    with calcidem.open_campaign(options.database) as campaign:
        for window in WINDOWS:
            fields = campaign.stiffness(seed=list(range(1, options.seeds + 1)), content=CONTENTS, window=window)
            for content in fields["content"].to_numpy():
                one = fields.sel(content=content)
                print(
                    f"| {1e3 * window:g} | {content:g} | {1e-6 * float(one.geometric_mean):.0f} "
                    f"| {float(one.log_deviation):.2f} | {1e3 * float(one.scale_x):.0f} "
                    f"| {1e3 * float(one.scale_y):.0f} | {float(one.unknown):.1%} |"
                )
            if window == WINDOWS[1]:
                (PAGE / "random-field.png").write_bytes(render(campaign.plot.stiffness(fields), "png"))


if __name__ == "__main__":
    main()
