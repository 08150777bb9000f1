"""Whatever goes wrong with a campaign, nothing is lost: the whole fault matrix.

    python benchmarks/faults/run.py              # the matrix: about 20 minutes on two free cores
    python benchmarks/faults/run.py --only kill  # the cases whose name contains a word

Every case is a small real campaign under the real mpirun. Exit code 1 if anything is not as it should be.
"""

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "app" / "robustness" / "programs"))

from fault_matrix import Trial, all_cases, judge, reference


def run_matrix(top: Path, cache: Path, word: str) -> bool:
    """Print a line for each case; tell whether all are as they should be."""
    (top / "reference").mkdir()
    expected = reference(Trial(top / "reference", cache))
    cases = [case for case in all_cases() if word.lower() in str(case).lower()]
    print(f"{'case':48} exit  seconds  stored  attempts at {len(expected)} cells in the end")
    bad = 0
    for number, case in enumerate(cases):
        folder = top / f"case-{number}"
        folder.mkdir()
        verdict = judge(case, Trial(folder, cache), expected)
        attempts = ", ".join(f"{count} {outcome}" for outcome, count in sorted(verdict.attempts.items()))
        print(f"{case!s:48} {verdict.exit_code:4d} {verdict.seconds:8.1f} {verdict.stored:7d}  {attempts}", flush=True)
        for complaint in verdict.complaints:
            print(f"    WRONG: {complaint}", flush=True)
        bad += bool(verdict.complaints)
    print(f"{len(cases)} cases, {bad} not as they should be; each continued twice, all values equal to the last bit")
    return not bad


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="cases whose name contains this")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="calcidem-faults-") as name:
        top = Path(name)
        cache = top / "cache"
        cache.mkdir()
        good = run_matrix(top, cache, options.only)
    sys.exit(not good)


if __name__ == "__main__":
    main()
