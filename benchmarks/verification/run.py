"""Every closed-form and cross-code check, and the table of them.

    python benchmarks/verification/run.py [--out docs/verification.md] [--only TEXT]

Takes two minutes on one core once the kernels are compiled. Rows of LAMMPS and YADE are measured where these programs are
installed; where they are not, the file keeps the row that it has, and the program says so. Exit code 1 if a check fails.
"""

import argparse
import sys
from pathlib import Path

from table import Check, all_checks, row_of

_HEAD = """# Verification

Does the kernel compute what it says? Each row below compares it with something that shares no code with it: a closed form, a
matrix put together and solved elsewhere, a law of conservation, a slow twin, another program. One command makes this page:

<!-- long: 2 minutes -->

    python benchmarks/verification/run.py --out docs/verification.md

It takes two minutes on one core. The scenes are in `benchmarks/verification`; radii, materials, directions and speeds were
picked once, away from those of the paper and of the tests; a tolerance follows from the reason beside it.
Errors are relative unless the row says what they are; rows that end in rounding differ in their last digits between
computers. `tests/dem/test_verification.py` repeats the quick rows in every run of the tests, all of them with `--full`.

LAMMPS and YADE are started as in [performance.md](performance.md), which says how to install them. Where one of them is missing,
its rows are skipped and keep what was measured last.

| what is checked | source of what is expected | measured error | tolerance | why it is that large |
|---|---|---|---|---|
"""
_OPEN = "not measured yet"
_TAIL = """
[whole-cells.md](whole-cells.md) has three whole samples, from the pulse to Vs, in YADE.

## What this does not show

* Rows prove the equations of the model, not that sand obeys them: a disk is no sphere, and Hertz's law of spheres is used for
  disks because PFC does so.
* Where contacts turn from slip to stick the error is of first order in the step; elsewhere of second. [accuracy.md](accuracy.md)
  gives the error of a campaign's velocities.
* Friction, damping and impacts together, over long times, are chaotic: no two programs agree on them disk by disk.
  [performance.md](performance.md) has the measurement.
"""


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


def rows_of(page: str) -> dict[str, str]:
    """Lines of the table of a page, by what they check."""
    lines = [line for line in page.splitlines() if line.startswith("| ")]
    return {line.split(" | ")[0].removeprefix("| "): line for line in lines[1:]}


def main() -> int:
    """Measure, print, write."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--out", type=Path, help="page to write")
    options.add_argument("--only", default="", help="measure rows whose name has this text; a page keeps the others")
    chosen = options.parse_args()
    checks = all_checks()
    kept = rows_of(chosen.out.read_text(encoding="utf-8")) if chosen.out and chosen.out.exists() else {}
    missing = missing_programs()
    made = {one.name: measured_row(one, kept, missing) for one in checks if chosen.only.lower() in one.name.lower()}
    if chosen.out:
        lines = [made[one.name][0] if one.name in made else kept.get(one.name, row_of(one, _OPEN)) for one in checks]
        chosen.out.write_text(_HEAD + "\n".join(lines) + "\n" + _TAIL, encoding="utf-8")
    failed = sum(not passes for _, passes in made.values())
    print(f"{len(made)} rows, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
