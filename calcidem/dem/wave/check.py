"""Check of a content: the same samples with everything different that must not matter.

Cement patterns are computed as the cells of a campaign will be. Two of them are computed again with the finite law,
double precision, half the time step, twice the samples in a period, and the pulse in both senses. The differences are
the numerical error of the content, and the effect of the pulse. They also choose the cheapest contact law and the time
step. All of them are computed again with the wave from the other side: a velocity that belongs to the sample would be
the same.

The patterns are those of the first seeds from 0 on that hold so much. So the choice depends on no seed of a campaign,
and is the same for its parts, for more seeds, and after an interruption.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import islice

from calcidem.dem.engine.scene import Law
from calcidem.dem.kernels.layout import Flags
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.propagation import send_waves
from calcidem.dem.wave.reading import Reading, arrival_shift, read_section
from calcidem.dem.wave.section import Section

PATTERNS = 8
_FINER = 2  # patterns that are computed with finer settings
_LANES = 4  # both senses of these
_ALLOWED = 0.01  # rms difference of the velocities above which a cheaper law or longer step is not taken
_HALVINGS = 3
_STUDENT = {_FINER: 2.2, PATTERNS: 1.18}
"""Student's t over the normal quantile, both at 95 %, for the rms of so many differences (4.30 and 2.31 over 1.96)."""


@dataclass(frozen=True, slots=True)
class Check:
    """Law and time step of a content, and the errors measured with them.

    Relative standard errors, None if unknown: no pattern has a wave in both runs, or, but for the two sides, one has a
    wave in one run only.
    """

    law: Law
    """`linear` or `finite`."""
    step_fraction: float
    """Time step over the stability limit."""
    numerical_error: float | None
    """Of both velocities, by law, time step, sampling and precision. That of Vs is the shift of the received wave over
    its travel time: two peaks of equal height may change places, which is the error of the reading.
    """
    pulse_effect: float | None
    """Of both velocities, by the strength of the pulse: from the difference of its two senses."""
    side_error: float | None
    """Of the effective velocity, by the side from which the wave comes: 1.18 times the root mean square difference of
    both sides over the root of 2.
    """


def with_check(experiment: Experiment, found: Check) -> Experiment:
    """The experiment with the law and the step of a check."""
    return experiment.with_wave(law=found.law, step_fraction=found.step_fraction)


def check_content(
    experiment: Experiment, content: float, lanes: int, *, raise_if_stopped: Callable[[], None] = lambda: None
) -> Check:
    """Compute the check samples of a content; choose law and step.

    The linear law is taken where it confirms the finite one to 1 %. Otherwise the step is halved, up to three times,
    as long as it matters by more. What remains is stated as error.

    Parameters
    ----------
    experiment
        Common settings.
    content
        Percent of the sand's mass.
    lanes
        Width of the campaign's kernel.
    raise_if_stopped
        Called every fraction of a second; may raise to end the run.
    """
    rule, frequency = experiment.wave, experiment.frequency(content)
    count = PATTERNS if content > 0.0 else 1  # without cement all samples are the same
    orderings = (experiment.once(Experiment.ordering, seed) for seed in range(32))
    holding = islice((one for one in orderings if one.maximum_content >= content), count)
    # If none holds so much, the first says what it holds.
    bonded = [one.at(content).bonded for one in (list(holding) or [experiment.ordering(0)])]

    usual = [(flags, 1.0) for flags in bonded]
    both = [(flags, sense) for sense in (1.0, -1.0) for flags in bonded[:_FINER]]

    def sections(settings: Experiment, samples: Sequence[tuple[Flags, float]], width: int) -> list[Section]:
        """Sections of patterns, each with a sense of the pulse."""
        found: list[Section] = []
        for begin in range(0, len(samples), width):
            flags, signs = zip(*samples[begin : begin + width], strict=True)
            found += send_waves(settings, flags, frequency, lanes=width, raise_if_stopped=raise_if_stopped, signs=signs)
        return found

    law, step = cheapest_law(experiment), rule.step_fraction
    for halving in range(_HALVINGS + 1):
        finer = sections(_finer(experiment, step), both, _LANES)
        forth, back = finer[: len(both) // 2], finer[len(both) // 2 :]
        here = sections(experiment.with_wave(law=law, step_fraction=step), usual, lanes)
        numerical = _apart(here, forth, experiment)
        if rule.law == "auto" and law == "linear" and not numerical <= _ALLOWED:
            law = "finite"
            here = sections(experiment.with_wave(law=law, step_fraction=step), usual, lanes)
            numerical = _apart(here, forth, experiment)
        if not numerical > _ALLOWED or halving == _HALVINGS:
            break
        step *= 0.5
    mirrored = experiment.once(from_other_side).with_wave(law=law, step_fraction=step)
    errors = (
        _STUDENT[_FINER] * numerical,
        _STUDENT[_FINER] / math.sqrt(2.0) * _apart(forth, back, experiment),
        _STUDENT[PATTERNS] * _by_side(here, sections(mirrored, usual, lanes), experiment),
    )
    return Check(law, step, *(error if math.isfinite(error) else None for error in errors))


def kernels_of(experiment: Experiment, lanes: int) -> tuple[tuple[str, Experiment, int], ...]:
    """Name, settings and width of the kernels that the samples of an experiment need; one more if a check refuses.

    That one is included for a GPU, which has to prove all its kernels before any cell is computed.
    """
    usual = experiment.with_wave(law=cheapest_law(experiment))
    if not experiment.is_checked:
        return (("samples", usual, lanes),)
    finer = ("check samples", _finer(experiment, experiment.wave.step_fraction), _LANES)
    if experiment.gpu and experiment.wave.law == "auto":
        return ("samples", usual, lanes), finer, ("finite law", experiment.with_wave(law="finite"), lanes)
    return ("samples", usual, lanes), finer


def cheapest_law(experiment: Experiment) -> Law:
    """Law that a check tries first."""
    if experiment.wave.law != "auto":
        return experiment.wave.law
    return "linear" if experiment.installation == "preserve" else "finite"


def _finer(experiment: Experiment, step_fraction: float) -> Experiment:
    """Settings that neglect less than those with this step."""
    return experiment.with_wave(
        law="finite",
        precision="float64",
        step_fraction=0.5 * step_fraction,
        samples_per_period=2 * experiment.wave.samples_per_period,
    )


def from_other_side(experiment: Experiment) -> Experiment:
    """The experiment with left and right exchanged, so that the wave comes from the other side."""
    return replace(experiment, packing=experiment.packing.mirrored())


def _by_side(here: Sequence[Section], there: Sequence[Section], experiment: Experiment) -> float:
    """Standard error by the side that transmits, of the samples with a known wave from both; NaN without any."""
    read = [
        (reading_of(section, experiment), reading_of(mirrored, experiment))
        for section, mirrored in zip(here, there, strict=True)
    ]
    known = [(one.wave, other.wave) for one, other in read if one and other and _are_known(one, other)]
    apart = [_relative(one.velocity, other.velocity) for one, other in known]
    return math.sqrt(0.5 * sum(each * each for each in apart) / len(apart)) if apart else math.nan


def _relative(one: float, other: float) -> float:
    """Difference of two velocities over their mean."""
    return (one - other) / (0.5 * (one + other))


def _apart(one: Sequence[Section], other: Sequence[Section], experiment: Experiment) -> float:
    """Root mean square difference of both velocities of as many sections as both have, relative.

    Infinite if a sample has a wave in one run only; NaN if no sample has a known one in both.
    """
    found = []
    for section, second in zip(one, other, strict=False):
        first, again = reading_of(section, experiment), reading_of(second, experiment)
        if (first is None) != (again is None):
            return math.inf
        if first is None or again is None or not _are_known(first, again):
            continue
        found.append(_relative(first.wave.velocity, again.wave.velocity))
        if first.verdict is None:
            found.append(arrival_shift(section, second, first.travel_time, experiment.pick) / first.travel_time)
    squares = [each * each for each in found if not math.isnan(each)]
    return math.sqrt(sum(squares) / len(squares)) if squares else math.nan


def reading_of(section: Section, experiment: Experiment) -> Reading | None:
    """Reading of a section; None without a wave."""
    found = None if section.problem else read_section(section, experiment.clamp, experiment.pick)
    return found if isinstance(found, Reading) else None


def _are_known(one: Reading, other: Reading) -> bool:
    """Whether the fits of two waves have an error; an unknown one is 1, as at an end of the velocities tried."""
    return max(one.wave.error, other.wave.error) < 1.0
