"""``calcidem init`` and ``calcidem run``: a configuration, and its campaign in this process or on MPI ranks."""

import re
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calcidem.app.cli.options import (
    DEFAULT_CONFIGURATION,
    IS_QUIET,
    IS_VERBOSE,
    ConfigurationFile,
    number_parser,
    refuse_options,
    say,
)
from calcidem.app.config.presets import PRESETS, preset_text, slurm_job
from calcidem.wording import advise, first_of, pluralize, tell

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from calcidem.app.config.schema import Configuration


Preset = StrEnum("Preset", {name.replace("-", "_").upper(): name for name in PRESETS})  # type: ignore[misc]  # not literal


def init_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File to write.")] = DEFAULT_CONFIGURATION,
    preset: Annotated[
        Preset | None,
        typer.Option(
            help="quick (default): 6 contents x 4 seeds; paper: 17 x 116; paper-as-printed: the same with the printed "
            "pulse of 5 m/s, on which its velocities depend."
        ),
    ] = None,
    full: Annotated[bool, typer.Option("--full", help="Include every key with its meaning.")] = False,
    grain_size: Annotated[
        str | None,
        typer.Option(
            metavar="SIZE",
            help="Mean diameter of your own sand, such as 0.3mm, or d10,d50,d90 by mass: 0.2mm,0.3mm,0.4mm.",
        ),
    ] = None,
    grading: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", help="Or its grading: a table of size (with unit) and percent finer by mass."),
    ] = None,
    disks: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv", help="Or its disks: columns x, y and radius in m, as 'calcidem import' writes."
        ),
    ] = None,
    stress: Annotated[
        str | None,
        typer.Option(metavar="STRESS", help="Its confining stress; 100kPa if not given."),
    ] = None,
    mineral: Annotated[
        str | None,
        typer.Option(
            metavar="MINERAL",
            help="Its grains: quartz (if not given), carbonate, calcite or glass; or shear modulus, Poisson's ratio "
            "and density, such as 30GPa,0.2,2500kg/m3.",
        ),
    ] = None,
    contents: Annotated[
        str | None, typer.Option(metavar="PERCENT,...", help="Its calcite contents; 0,1,2,4 if not given.")
    ] = None,
    slurm: Annotated[
        bool,
        typer.Option("--slurm", help="Also write its Slurm job, FILE.sbatch; a configuration that exists is kept."),
    ] = False,
) -> None:
    """Write a configuration: an example, or one for your own sand."""
    if not file.name:
        raise typer.BadParameter(f"{file} is a folder or a device; give the name of a file")
    chosen = preset or next(iter(Preset))
    sizes = {"--grain-size": grain_size, "--grading": grading, "--disks": disks}
    given = [name for name, value in sizes.items() if value is not None]
    if not given:
        of_a_sand = {"--stress": stress, "--mineral": mineral, "--contents": contents}
        refuse_options("give --grain-size, --grading or --disks, too: it is for a sand of your own", of_a_sand)
        text = preset_text(chosen)
        if full:
            from calcidem.app.config.examples import full_text  # the reader of configurations takes a second to load

            text = full_text(chosen)
    elif preset is not None or full:
        raise typer.BadParameter("leave --preset and --full out: they are for examples", param_hint=given[0])
    elif len(given) > 1:
        said = "the disks have their sizes" if disks is not None else "the grading has it"
        raise typer.BadParameter(f"leave it out: {said}", param_hint=given[0])
    else:
        from calcidem.app.config.examples import OwnSand, read_grading  # as above

        size = disks if grain_size is None else grain_size
        size = ",".join(f"{d!r}m" for d in read_grading(grading or Path())) if size is None else size
        given_words = (stress, "100kPa"), (mineral, "quartz"), (contents, "0,1,2,4")
        words = [default if word is None else word for word, default in given_words]
        own = OwnSand.of_words(size, words[0], words[1], words[2], file.parent, given[0])
        text = own.text()
        if 0.0 < max(own.contents) < 0.1:
            say(f"Contents are percent of the sand's mass: is {max(own.contents):g} % meant, not a fraction?", err=True)
    if slurm:
        job = file.with_suffix(".sbatch")
        _write_new(job, slurm_job(file.name), "submit it, or remove it first")
        say(f"Wrote {job}. Edit its first lines, then, in its folder: sbatch {job.name}")
        if file.exists():
            return
    other = file.with_stem(f"{file.stem}-{chosen}")
    another = "give another name" if given else f"write another with 'calcidem init {other} --preset {chosen}'"
    _write_new(file, text, f"run it with 'calcidem run {file}', or {another}")
    say(f"Wrote {file}. Edit it as you like, then: calcidem run {file}")
    if given:
        decisions = "file|height|diameter|stress|bond_modulus|frequency|amplitude|slowest"
        found = re.findall(rf"(?m)^({decisions}) = (.*?) +# (.*)", text)
        tell("\n".join(f"  {key} = {value}: {reason}" for key, value, reason in found))


def _write_new(file: Path, text: str, remedy: str) -> None:
    """Write a file that must not exist yet."""
    try:
        with file.open("x", encoding="utf-8") as target:
            target.write(text)
    except FileExistsError:
        if not file.is_file():
            raise typer.BadParameter(f"{file} is a folder or a device; give the name of a file") from None
        raise typer.BadParameter(f"{file} exists and was left unchanged; {remedy}") from None


_Retried = StrEnum("_Retried", ["FAILED", "TIMED_OUT", "QUARANTINED"])


def run_command(
    configuration: ConfigurationFile = DEFAULT_CONFIGURATION,
    database: Annotated[str | None, typer.Option("--db", metavar="DB", help="SQLite file or database URL.")] = None,
    output: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for the results.")] = None,
    part: Annotated[
        str | None,
        typer.Option(metavar="K/N", help="Compute only part K of N of about equal effort."),
    ] = None,
    ranks: Annotated[
        int | None,
        typer.Option(min=0, max=100_000, help="MPI ranks (rank 0 only coordinates); 0: one per core, plus one."),
    ] = None,
    dask: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Compute on the workers of this Dask scheduler.")
    ] = None,
    gpu: Annotated[bool, typer.Option("--gpu", help="Propagate the waves on NVIDIA GPUs, with the same bits.")] = False,
    restarts: Annotated[
        int | None,
        typer.Option(min=0, metavar="K", help="With --ranks: start again up to K times (3) if a rank dies."),
    ] = None,
    start_timeout: Annotated[
        float,
        typer.Option(
            parser=number_parser(1.0, 1e6, "is not a number of seconds from 1 to 1,000,000"),
            metavar="SECONDS",
            help="With --ranks: time for the ranks to begin.",
        ),
    ] = 120.0,
    with_report: Annotated[bool, typer.Option("--report", help="Also write the report.")] = False,
    retry: Annotated[
        list[_Retried] | None,
        typer.Option(help="Also compute cells of this status again (repeatable); quarantined: three runs died at it."),
    ] = None,
    check: Annotated[
        bool,
        typer.Option("--check", help="Compute nothing: check configuration and machine, estimate time and memory."),
    ] = False,
    serve: Annotated[bool, typer.Option("--serve", help="Show the run in the browser.")] = False,
    packing_only: Annotated[
        bool,
        typer.Option("--packing-only", help="Only make, cache and report on the packing."),
    ] = False,
) -> None:
    """Compute a campaign, or its missing cells: after a stop, the same command continues."""
    overrides = {
        "database": database,
        "output": None if output is None else str(output),
        "part": part,
        "gpu": gpu or None,
    }
    if part is not None and with_report:
        raise typer.BadParameter("a part is not a whole campaign; merge the parts first", param_hint="--report")
    if check or packing_only:
        refuse_options("leave it out: no cell is computed", {"--serve": serve, "--retry": retry})
        refuse_options("leave it or --check out: no packing is made", {"--packing-only": check and packing_only})
        loaded = _read_overridden(configuration, overrides)
        if check:
            from calcidem.app.campaign.preview import preview_lines

            say("\n".join(preview_lines(loaded, ranks)))
        else:
            _make_packing_alone(loaded)
        return
    if dask is not None and ranks is not None:
        raise typer.BadParameter("leave --ranks out: the workers of the cluster compute", param_hint="--dask")
    if restarts is not None and (ranks is None or ranks == 1):
        raise typer.BadParameter(
            "give --ranks too, with 2 or more: only MPI ranks can be restarted", param_hint="--restarts"
        )
    with _live_page(configuration, overrides) if serve else nullcontext():
        from calcidem.sweep.ranks import run_on_ranks
        from calcidem.sweep.schedule import StopRequest

        load = partial(_read_overridden, configuration, overrides, retry or ())
        if ranks is not None and ranks != 1:
            from calcidem.app.campaign.launch import Launch
            from calcidem.app.cli.views import TerminalView

            options = {"--db": database, "--output": output, "--part": part}
            arguments = ["run", str(configuration)]
            arguments += [word for name, value in options.items() if value is not None for word in (name, str(value))]
            arguments += [
                name
                for name, is_on in (("--gpu", gpu), ("--quiet", IS_QUIET.get()), ("--verbose", IS_VERBOSE.get()))
                if is_on
            ]
            launch = Launch(arguments, ranks, 3 if restarts is None else restarts, start_timeout)
            code = launch.run(load, TerminalView(with_report=with_report, cores_used=True))
        elif dask is not None:
            from calcidem.app.campaign.run import dask_executor, run_command_line
            from calcidem.app.cli.views import TerminalView

            view = TerminalView(with_report=with_report, cores_used=True)
            with dask_executor(dask) as executor, StopRequest() as stop:
                code = run_command_line(load, view, executor, stop)
        else:
            import calcidem.app.campaign.cells  # noqa: F401 - what every rank needs, while rank 0 prepares

            def lead(executor: "Executor | None", stop: StopRequest) -> int:
                """Run the command on rank 0, which alone needs the database and a view."""
                from calcidem.app.campaign.run import run_command_line
                from calcidem.app.cli.views import TerminalView

                view = TerminalView(with_report=with_report, cores_used=False)
                return run_command_line(load, view, executor, stop)

            code = run_on_ranks(lead)
        raise typer.Exit(code)


def _make_packing_alone(configuration: "Configuration") -> None:
    """Make the packing alone, and report on it."""
    from calcidem.app.campaign.packing import provide_packing
    from calcidem.app.campaign.preview import wave_doubts
    from calcidem.app.cli.views import packing_lines
    from calcidem.app.config.checks import check_against_packing

    packing = provide_packing(configuration, None)
    say("\n".join(packing_lines(packing)))
    for warning in (*check_against_packing(configuration, packing), *wave_doubts(configuration, packing)):
        advise(f"{warning}.")


def _live_page(configuration: Path, overrides: Mapping[str, str | bool | None]) -> AbstractContextManager[None]:
    """Live page of the campaign while the command runs."""
    from calcidem.app.serve import page_beside_run
    from calcidem.sweep.ranks import launcher

    if launcher() is not None:
        raise typer.BadParameter(
            f"leave it out under {launcher()}: 'calcidem serve DB --wait' beside the run does it", param_hint="--serve"
        )
    wanted = _read_overridden(configuration, overrides)
    return page_beside_run(wanted.database, wanted.campaign.name, typer.echo)  # a result, also with --quiet


def _read_overridden(
    configuration: Path, overrides: Mapping[str, str | bool | None], retry: Sequence[_Retried] = ()
) -> "Configuration":
    """Configuration, on rank 0 alone, so that the others do not import its reader. Cells to retry become pending."""
    from calcidem.app.config.reader import load_configuration

    loaded = load_configuration(configuration, overrides)
    beside = configuration.parent / loaded.database
    if not Path(loaded.database).exists() and beside.is_file():  # a URL of a server is neither
        place = f"{loaded.database} does not exist here, but {beside} is beside the configuration"
        tell(f"Note: {place}. To continue it, stop this run and give --db {beside}")
    if retry:
        from calcidem.app.campaign.run import retry_cells
        from calcidem.ends import CellStatus

        pending = retry_cells(loaded, [CellStatus(outcome.value) for outcome in retry])
        head = f"{pluralize(len(pending), 'cell')} to compute again:" if pending else "There is nothing to retry."
        tell("\n  ".join([head, *first_of(list(map(str, pending)))]))
    return loaded
