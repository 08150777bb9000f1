"""The command `calcidem accuracy`: a study of the configuration's own scenes, as tables, figure and JSON."""

from collections.abc import Callable, Sequence
from pathlib import Path

from calcidem.analysis.figures.style import save
from calcidem.app.accuracy.figure import error_against_run_time
from calcidem.app.accuracy.report import as_json, name_of, tables
from calcidem.app.accuracy.settings import REFERENCE_STEP
from calcidem.app.accuracy.study import cheapest, run_study
from calcidem.dem.measurement import Experiment


def accuracy(
    experiment: Experiment,
    contents: Sequence[float],
    seeds: Sequence[int],
    *,
    out: Path | None = None,
    json: bool = False,
    target: str | None = None,
    reference_step: float = REFERENCE_STEP,
    say: Callable[[str], None],
    progress: Callable[[str], None] = lambda _: None,
) -> None:
    """Measure error against run time and say what came out.

    Parameters
    ----------
    experiment, contents, seeds
        What to measure.
    out
        Folder for the figure, ``accuracy.md`` and ``accuracy.json``.
    json
        Say JSON instead of tables.
    target
        Error of Vs, as in ``0.5%`` or ``0.005``: also says the cheapest setting that meets it.
    reference_step
        See `run_study`.
    say, progress
        Told the result, and what is done.

    Raises
    ------
    ValueError
        If the target is no positive number.
    """
    wanted = None if target is None else share(target)
    study = run_study(experiment, contents, seeds, reference_step=reference_step, progress=progress)
    if out is not None:
        save(error_against_run_time(study), out, "accuracy", ("png",))
        (out / "accuracy.md").write_text(tables(study))
        (out / "accuracy.json").write_text(as_json(study))
    say(as_json(study) if json else tables(study))
    if wanted is not None and not json:
        say(f"Cheapest setting with an error of at most {100 * wanted:g} %: {name_of(cheapest(study, wanted))}")


def share(text: str) -> float:
    """Turn ``0.5%`` or ``0.005`` into 0.005."""
    number, scale = (text[:-1], 0.01) if text.rstrip().endswith("%") else (text, 1.0)
    try:
        value = float(number) * scale
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1.0:
        raise ValueError(f"target = {text}: give a part of Vs such as 0.5% or 0.005")
    return value
