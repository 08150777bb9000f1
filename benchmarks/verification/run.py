"""Every closed-form and cross-code check, and the table of them.

    python benchmarks/verification/run.py [--out docs/verification.md] [--only TEXT]

The table replaces that of the page, and takes two minutes on one core once the kernels are compiled. Rows of LAMMPS and
YADE are measured where these programs are installed; where they are not, the page keeps the row that it has, and the
program says so. Exit code 1 if a check fails.
"""

import argparse
import re
import sys
from pathlib import Path

from table import Check, all_checks, row_of

_TABLE = re.compile(r"(?<=<!-- table -->\n).*?(?=<!-- end -->)", re.DOTALL)
_HEAD = "| what is checked | measured error |\n|---|---|\n"
_OPEN = "not measured yet"


def measured_row(one: Check, kept: dict[str, str], missing: list[str]) -> tuple[str, bool]:
    """Line of the table, and whether the check passes; one that cannot be made keeps its line."""
    if one.program in missing:
        reason = f"skipped: {one.program} is not installed, see docs/performance.md"
        print(f"{'':8s} {one.name}: {reason}; the table keeps what it has", flush=True)
        return kept.get(one.name, row_of(one, _OPEN)), True
    error = one.measure()
    passes = error <= one.tolerance
    print(f"{error:8.1e} {one.name}{'' if passes else f': FAILS, tolerance {one.tolerance:.0e}'}", flush=True)
    return row_of(one, f"{error:.1e}" if error else "0"), passes


def missing_programs() -> list[str]:
    """Programs of the cross-code rows that this computer lacks."""
    from crosscode import programs  # noqa: PLC0415 - brings the modules of benchmarks/peers along

    return programs().missing


def table_of(lines: dict[str, str], checks: list[Check]) -> str:
    """Rows below their sources, each source once, in the order of its first row."""
    sources = dict.fromkeys(one.source for one in checks)
    return "".join(
        f"| *{source}* | |\n" + "".join(f"{lines[one.name]}\n" for one in checks if one.source == source)
        for source in sources
    )


def rows_of(page: str) -> dict[str, str]:
    """Lines of the table of a page, by what they check."""
    lines = [line for table in _TABLE.findall(page) for line in table.splitlines() if line.startswith("| ")]
    return {line.split(" | ")[0].removeprefix("| "): line for line in lines[1:]}


def main() -> int:
    """Measure, print, write."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--out", type=Path, help="page whose table is replaced")
    options.add_argument("--only", default="", help="measure rows whose name has this text; a page keeps the others")
    chosen = options.parse_args()
    checks = all_checks()
    page = chosen.out.read_text(encoding="utf-8") if chosen.out else ""
    kept = rows_of(page)
    missing = missing_programs()
    made = {one.name: measured_row(one, kept, missing) for one in checks if chosen.only.lower() in one.name.lower()}
    if chosen.out:
        lines = {one.name: kept.get(one.name, row_of(one, _OPEN)) for one in checks}
        lines |= {name: line for name, (line, _) in made.items()}
        chosen.out.write_text(_TABLE.sub(lambda _: _HEAD + table_of(lines, checks), page), encoding="utf-8")
    failed = sum(not passes for _, passes in made.values())
    print(f"{len(made)} rows, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
