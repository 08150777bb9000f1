"""Command `calcidem accuracy`: a study of the configuration's scenes."""

import json
from collections.abc import Mapping, Sequence
from functools import partial

from calcidem.app.config.schema import Configuration
from calcidem.app.studies.accuracy.questions import Findings, answer_questions
from calcidem.app.studies.accuracy.report import accuracy_page, accuracy_tables, draw_error_against_run_time
from calcidem.app.studies.accuracy.settings import DEFAULT, Setting, settings
from calcidem.app.studies.accuracy.study import run_study
from calcidem.app.studies.cells import Cells
from calcidem.app.studies.results import StudyResult
from calcidem.dem.wave.experiment import Experiment


def accuracy(
    configuration: Configuration,
    cells: Cells,
    velocities: Mapping[float, Sequence[float]] | None = None,
    *,
    only: Sequence[str] = (),
    target: str | None = None,
) -> StudyResult:
    """Measure error over run time.

    ``velocities`` at each content, m/s, supply the scatter of the samples; without them a few samples are measured.
    With names of settings in ``only``, only these and the default are compared with the reference. ``target`` is an
    error for which the text names the cheapest setting. `ValueError` for an unknown name or target.
    """
    rounds = {"rounds": 1} if only else {}
    study = run_study(cells, compared=choose_settings(cells.experiment, only), **rounds)
    findings = Findings(configuration.hash, cells.experiment.packing.content_hash, study)
    if not only:
        findings = answer_questions(findings, configuration, cells, velocities)
    text, json_text = "\n\n".join(accuracy_tables(findings).values()), findings.as_json()
    if target is not None:
        chosen = study.cheapest_in_words(parse_target(target))
        text += f"\nCheapest setting with an error of at most {target}: {chosen}"
    rows = json.loads(json_text)["study"]["cells"]
    figures = {"": partial(draw_error_against_run_time, study)}
    return StudyResult(text, accuracy_page(findings), rows, json_text, figures=figures)


def choose_settings(experiment: Experiment, only: Sequence[str]) -> list[Setting]:
    """Return the default and the settings of these names, all without names; `ValueError` for an unknown name."""
    known = {setting.name: setting for setting in settings(experiment)}
    for name in only:
        if name not in known:
            raise ValueError(f"only = {name}: choose among {', '.join(known)}")
    return [known[DEFAULT], *(known[name] for name in only or known if name != DEFAULT)]


def parse_target(text: str) -> float:
    """Parse ``0.5%`` or ``0.005`` as 0.005."""
    digits, scale = (text[:-1], 0.01) if text.rstrip().endswith("%") else (text, 1.0)
    try:
        value = float(digits) * scale
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1.0:
        raise ValueError(f"target = {text}: give a part of Vs such as 0.5% or 0.005")
    return value
