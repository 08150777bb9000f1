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
## Whole cells in YADE

<!-- long: 40 minutes, needs YADE -->

    python benchmarks/peers/whole_cells.py [--quick] [--figure docs/whole-cells.png]

Three cemented samples of `paper-small-pulse` (seed 1) are exported as they are before the pulse: disks, contacts with their shear forces,
bonds, walls, loads. YADE computes the same laws until the campaign's record ends. The same reading takes Vs from both signals.
LAMMPS takes no part: its bonds between unequal disks are another law.

![received signals of both programs](whole-cells.png)

In the columns: difference of the received signals (root mean square, over calcidem's), velocities, their difference, and the numerical error that
the campaign states. *Linear* is the preset's regime. *Slip* is Coulomb's limit; without it contacts stick.

| calcite, % | laws | step | signal, % | Vs, calcidem | Vs, YADE | difference, % | stated bound, % |
|---|---|---|---|---|---|---|---|
| 0.66 | linear, as the preset | 1/1 | 0.225 | 371.39 | 371.37 | -0.005 | 0.92 |
| 0.66 | linear, as the preset | 1/2 | 0.113 | 371.40 | 371.40 | -0.001 | 0.92 |
| 0.66 | linear, no damping | 1/1 | 0.002 | 405.62 | 405.62 | +0.000 | 0.92 |
| 0.66 | finite, no damping, no slip | 1/1 | 0.139 | 405.58 | 405.57 | -0.003 | 0.92 |
| 0.66 | finite, slip and damping | 1/1 | 0.264 | 371.28 | 371.23 | -0.012 | 0.92 |
| 2.55 | linear, as the preset | 1/1 | 0.196 | 598.12 | 598.10 | -0.003 | 1.16 |
| 2.55 | linear, as the preset | 1/2 | 0.085 | 598.11 | 598.10 | -0.002 | 1.16 |
| 2.55 | linear, no damping | 1/1 | 0.002 | 638.85 | 638.85 | -0.000 | 1.16 |
| 2.55 | finite, no damping, no slip | 1/1 | 0.051 | 638.56 | 638.53 | -0.004 | 1.16 |
| 2.55 | finite, slip alone | 1/1 | 0.051 | 638.72 | 638.69 | -0.004 | 1.16 |
| 2.55 | finite, damping alone | 1/1 | 0.196 | 597.87 | 597.83 | -0.006 | 1.16 |
| 2.55 | finite, slip and damping | 1/1 | 0.196 | 598.01 | 597.97 | -0.006 | 1.16 |
| 7 | linear, as the preset | 1/1 | 0.136 | 1803.26 | 1803.20 | -0.003 | 0.57 |
| 7 | linear, as the preset | 1/2 | 0.067 | 1803.20 | 1803.22 | +0.001 | 0.57 |
| 7 | linear, no damping | 1/1 | 0.000 | 1824.98 | 1824.98 | +0.000 | 0.57 |
| 7 | finite, no damping, no slip | 1/1 | 0.024 | 1824.88 | 1824.86 | -0.002 | 0.57 |
| 7 | finite, slip alone | 1/1 | 0.024 | 1824.88 | 1824.86 | -0.002 | 0.57 |
| 7 | finite, damping alone | 1/1 | 0.151 | 1803.29 | 1803.18 | -0.006 | 0.57 |
| 7 | finite, slip and damping | 1/1 | 0.151 | 1803.29 | 1803.18 | -0.006 | 0.57 |
| 7 | finite, slip and damping | 1/2 | 0.078 | 1803.20 | 1803.19 | -0.001 | 0.57 |

Velocities differ by 0.012 % at most, a seventieth of the stated error. Three samples at one pulse cannot show more. Signals differ for two reasons:

* **Damping.** YADE takes the sign of the velocity at the whole step, calcidem half a step before. The difference halves with the step.
  Without damping the linear signals agree to 2e-5.
* **Walls.** YADE has large spheres where calcidem has flat walls. A sphere of the disk's size in place of the transmitter turns the contact as it slides
  along it, and adds 1e-3.
  With spheres 30 times as large there, and 3 times at the other walls, 0.104 % became 0.051 % at 2.55 % without damping. What is left was not traced.

Slip adds nothing to them, alone or together with damping. All this is at a pulse of 1 mm/s. Neither bonds that break nor pulses of 5 m/s were compared.

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
