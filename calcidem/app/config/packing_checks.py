"""What can be said of a configuration only when its packing is there."""

from collections.abc import Sequence

from calcidem.app.config.errors import ConfigurationError, Problem, shown
from calcidem.app.config.schema import Configuration
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.domain import listening_disks
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.propagation import wave_scene

FEW_SEEDS = 8

SAFE_PART = 0.8
"""Part of the largest content of a few seeds that every other seed holds too."""


def check_against_packing(configuration: Configuration, packing: Packing) -> None:
    """Refuse what the packing that was made cannot hold.

    Raises
    ------
    ConfigurationError
        With everything that is wrong.
    """
    problems = []
    experiment, plan = configuration.experiment(packing), configuration.campaign
    try:
        wave_scene(packing, configuration.sand, configuration.wave, None)
    except ValueError as error:
        problems.append(Problem(f"wave.{error}"))
    if not len(listening_disks(packing, configuration.wave)):
        problem = f"wave.listening_depth = {configuration.wave.listening_depth}: holds no disk at the receiver"
        problems.append(Problem(f"{problem}; make it or wave.receiver_half_width larger"))
    seed, room = tightest_seed(experiment, plan.seed_numbers, max(plan.contents))
    if max(plan.contents) > room:
        limit = f"the packing holds at most {room:.4g} % of calcite (seed {seed})"
        problems.append(Problem(f"campaign.contents = {shown(plan.contents)}: {limit}; leave larger contents out"))
    if problems:
        raise ConfigurationError("configuration", problems)


def tightest_seed(experiment: Experiment, seeds: Sequence[int], content: float) -> tuple[int, float]:
    """Seed whose sample holds the least calcite, and how much that is, percent.

    The first seeds tell enough for a content that is far from it: to draw the cement of every seed takes a while
    where there are thousands.
    """
    few = seeds[:FEW_SEEDS]
    room = {seed: experiment.ordering(seed).maximum_content for seed in few}
    if content > SAFE_PART * min(room.values()):
        room |= {seed: experiment.ordering(seed).maximum_content for seed in seeds[FEW_SEEDS:]}
    tightest = min(room, key=lambda seed: room[seed])
    return tightest, room[tightest]
