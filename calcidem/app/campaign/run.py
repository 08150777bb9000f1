"""One campaign from its configuration to its database, in one process or on many ranks."""

import os
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from itertools import starmap
from typing import TYPE_CHECKING, Any, Self

from calcidem.app.campaign.display import choose_display
from calcidem.app.campaign.identity import choose_campaign
from calcidem.app.campaign.packing import Tell, provide_packing
from calcidem.app.campaign.parts import batches_of, planned_batches
from calcidem.app.campaign.progress import ProgressReporter, RunProgress, RunStage
from calcidem.app.campaign.provenance import describe_run
from calcidem.app.campaign.store_sink import StoreSink
from calcidem.app.campaign.stored_packing import packing_record, stored_packing
from calcidem.app.campaign.task import CellComputation, kernel_compilations
from calcidem.app.campaign.workers import describe_unlike, describe_worker, group_workers
from calcidem.app.config.checks import check_against_packing
from calcidem.app.config.schema import Configuration
from calcidem.dem.sample.packing import PackingStage
from calcidem.storage.errors import ForeignDatabaseError, LeaseHeldError, StoreError, StoreUnavailableError
from calcidem.storage.records import CellKey, CellStatus, PackedResult, WorkerRecord
from calcidem.storage.sql.engine import Address
from calcidem.storage.sql.store import Store
from calcidem.storage.store import Selection
from calcidem.sweep.batch import Batch, Cell
from calcidem.sweep.options import SweepOptions
from calcidem.sweep.outcome import BatchOutcome
from calcidem.sweep.processes import keep_freed_memory
from calcidem.sweep.progress import Progress
from calcidem.sweep.run import run_sweep
from calcidem.sweep.signals import StopRequest
from calcidem.sweep.sweep_end import SweepEnd, SweepState, WorkersLostError

if TYPE_CHECKING:
    from calcidem.app.campaign.opened import Campaign  # for statistics, which the ranks do not need
    from calcidem.app.campaign.until import SeedDemand

_LEASE_POLL = 1.0
"""Seconds between two checks of a lease that another machine holds."""


def run(
    configuration: Configuration | str | os.PathLike[str],
    *,
    db: str | os.PathLike[str] | None = None,
    output: str | os.PathLike[str] | None = None,
    set: Mapping[str, object] | None = None,  # noqa: A002 - reads as what it does: run(..., set={"wave.damping": 0.2})
    progress: Callable[[RunProgress], object] | bool | None = None,
    executor: Executor | None = None,
) -> "Campaign":
    """Compute a campaign, or its missing cells, in this process or on the workers of an executor.

    `ConfigurationError` with all problems of the configuration; `StoreError` if the database cannot be used;
    `PackingError` if the packing does not come to rest; `WorkersLostError` if the executor ended too early, for
    instance because one of its processes was killed. Computed cells are then stored, and the same call with a new
    executor continues.

    Parameters
    ----------
    configuration
        Configuration, or the name of its TOML file.
    db
        SQLite file or database URL; by default that of the configuration.
    output
        Folder for the results; by default that of the configuration.
    set
        Values that replace those of the configuration, such as ``{"wave.amplitude": 1e-4}``.
    progress
        A function that receives the progress, at most a few times a second; its exceptions end the run, which the same
        call continues later. True shows the progress, False does not; by default it is shown on a terminal and in a
        notebook.
    executor
        Executor whose workers compute: a ``concurrent.futures.ProcessPoolExecutor``, an
        ``mpi4py.futures.MPIPoolExecutor``, ``Client.get_executor()`` of Dask, or any other. The workers need this
        version of calcidem, but not the database. The executor stays open.

    Returns
    -------
    Campaign
        Opened for reading; close it after use.

    Examples
    --------
    >>> with calcidem.run("quick.toml", db="quick.db") as campaign:  # doctest: +SKIP
    ...     print(campaign.vs().mean("seed"))

    On all cores:

    >>> from concurrent.futures import ProcessPoolExecutor
    >>> with ProcessPoolExecutor() as pool, calcidem.run("quick.toml", executor=pool) as campaign:  # doctest: +SKIP
    ...     print(campaign.summary())
    """
    from calcidem.app.campaign.opened import open_campaign  # noqa: PLC0415 - as above
    from calcidem.app.config.reader import change_configuration  # noqa: PLC0415 - the reader, which workers do not need

    values = dict(set or {})
    values |= {"run.database": os.fspath(db)} if db is not None else {}
    values |= {"run.output": os.fspath(output)} if output is not None else {}
    if values or not isinstance(configuration, Configuration):
        configuration = change_configuration(configuration, values)
    keep_freed_memory()
    with choose_display(progress) as display:
        reporter = ProgressReporter(display)
        with CampaignRun(configuration, [describe_worker(rank=0)], display.note, watch=reporter.on_packing) as work:
            if work.batches:
                reporter.begin(RunStage.COMPILING)
                if executor is None:
                    for compile_kernel in kernel_compilations(configuration, work.packing, reporter.on_compiling):
                        compile_kernel()
            end = work.compute(executor, reporter, StopRequest())  # not set by signals: an interrupt goes to the caller
            if end.state is not SweepState.COMPLETE:
                raise WorkersLostError(f"{end.detail} (everything stored is safe)")
            for line in work.demand.lines() if work.demand else ():
                display.note(line)
    return open_campaign(configuration.database, configuration.campaign.name)


def sweep_options(configuration: Configuration) -> SweepOptions:
    """Limits of the sweep from the configuration."""
    return SweepOptions(time_limit=configuration.run.time_limit)


class CampaignRun:
    """State of rank 0 while a campaign is computed: database, packing and remaining batches.

    As a context manager it closes the database and records the end of the run. An existing database is checked before
    the packing is made, so that one of another campaign is refused at once. A new one is created after the packing, so
    that a configuration that the packing cannot fulfil creates none.

    Parameters
    ----------
    configuration
        Configuration to compute.
    workers
        Description of each rank.
    tell
        Receives sentences for the user.
    check
        Called every fraction of a second while the packing is made; may raise to end it.
    watch
        Called as often with the progress.

    Attributes
    ----------
    packing, store
        Packing and store of the campaign.
    batches
        Remaining batches, in order.
    sink
        Receiver of the outcomes.
    demand
        Numbers of seeds that each content needs; None without `until` in the configuration.
    end
        Of the sweep; None before it.
    """

    def __init__(
        self,
        configuration: Configuration,
        workers: Sequence[WorkerRecord],
        tell: Tell,
        check: Callable[[], None] = lambda: None,
        watch: Callable[[PackingStage], None] = lambda _: None,
    ) -> None:
        self.configuration = configuration
        self.end: SweepEnd | None = None
        self.demand: SeedDemand | None = None
        _refuse_before_writing(configuration)
        configuration.output.mkdir(parents=True, exist_ok=True)  # before hours of computation
        store = self._master(tell, check) if _exists(configuration.database) else None
        try:
            self.packing = provide_packing(configuration, store, tell, check, watch)
            for warning in check_against_packing(configuration, self.packing):
                tell(f"Warning: {warning}.")
            store = store or self._master(tell, check)
            self.store: Store = store
            self._begin(workers, tell)
        except BaseException:
            if store is not None:
                store.close()
            raise

    def _master(self, tell: Tell, check: Callable[[], None]) -> Store:
        """Open the database and become the only writer of this campaign."""
        configuration = self.configuration
        path = Address.parse(configuration.database).path
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)

        store = Store(configuration.database)
        try:
            store.begin_campaign(configuration.record())
            for sentence in _acquire_lease(store, tell, check):
                tell(sentence)
        except BaseException:
            store.close()
            raise
        return store

    def _begin(self, workers: Sequence[WorkerRecord], tell: Tell) -> None:
        """Plan the cells and the batches."""
        plan = self.configuration.campaign
        record = packing_record(self.packing, index=0, packing_hash=self.configuration.packing_hash)
        self.store.save_packing(record)
        self.store.extend(plan.seed_numbers, plan.contents)
        if plan.until is None:
            own = {cell for batch in planned_batches(self.configuration) for cell in batch.cells}
        else:
            from calcidem.app.campaign.until import SeedDemand  # noqa: PLC0415 - statistics

            self.demand = SeedDemand.of_store(self.store, plan)
            own = set(self.demand.cells)
            self.store.plan(starmap(CellKey, own))
        self.store.use_campaign(plan.name)  # with the whole plan
        pending = self.store.pending(contents=plan.contents)
        kinds = group_workers(workers)
        self.sink = StoreSink(self.store, pending, tell, kinds)
        self._losses = self.sink.losses
        self.batches = batches_of(
            self.configuration,
            ((key.seed, key.content) for key in pending if (key.seed, key.content) in own),
            self._losses,
        )
        self.store.begin_run(replace(describe_run(len(workers)), workers=kinds))
        if unlike := describe_unlike(kinds):
            tell(unlike)

    def compute(self, where: Any, reporter: Progress, stop_request: StopRequest) -> SweepEnd:  # noqa: ANN401 - with MPI's type, which only the scheduler knows
        """Have the batches computed and store the outcomes; ``where`` is that of `calcidem.sweep.run.run_sweep`.

        `StoreError` if the database is no longer there, or was damaged meanwhile: then nothing is complete.
        """
        self.end = run_sweep(
            where,
            self.batches,
            CellComputation(self.configuration, self.packing),
            self.sink,
            options=sweep_options(self.configuration),
            progress=reporter,
            stop_request=stop_request,
            more=self._more,
        )
        self.store.renew_lease()
        self.store.refuse_damaged()
        return self.end

    def _more(self, outcomes: Sequence[BatchOutcome[Cell, PackedResult]]) -> tuple[Batch[Cell], ...]:
        """Further batches that the outcomes require, if the configuration has `until`."""
        if self.demand is None:
            return ()
        cells = self.demand.take_in(outcomes)
        self.sink.plan(starmap(CellKey, cells))
        return batches_of(self.configuration, cells, self._losses)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        """Record the end and close the database."""
        with suppress(StoreError), self.store:  # the last write has reported a lost database
            if self.end is not None:
                detail = f": {self.end.detail}" if self.end.detail else ""
                self.store.end_run(f"{self.end.state}{detail}", datetime.now(UTC))


def _acquire_lease(store: Store, tell: Tell, check: Callable[[], None]) -> tuple[str, ...]:
    """Acquire the lease; wait until the lease of a silent master on another machine ends.

    `LeaseHeldError` if another master lives: on this machine, or with a new heartbeat meanwhile.
    """
    first = None
    while True:
        try:
            return store.acquire_lease()
        except LeaseHeldError:
            holder = store.lease_holder()
            if holder is None or holder.is_here() or holder != (first or holder):
                raise
        if first is None:
            tell(
                f"Process {holder.pid} on {holder.host} was writing this campaign, last heartbeat at "
                f"{holder.heartbeat:%H:%M:%S} UTC: waiting for a heartbeat, or until it counts as dead after five "
                "minutes of silence."
            )
        first = holder
        check()
        time.sleep(_LEASE_POLL)


def _refuse_before_writing(configuration: Configuration) -> None:
    """Refuse a configuration that does not match its database or the packing there, before any byte is written.

    Errors are those of `choose_campaign`, and `ConfigurationError` if the packing cannot hold what is planned.
    """
    if not _exists(configuration.database):
        return

    # An empty database is refused for reading, and new for writing.
    with suppress(ForeignDatabaseError), Store(configuration.database, read_only=True) as store:
        if choose_campaign(store, configuration) and store.packing_indices():
            check_against_packing(configuration, stored_packing(store.packing()))


def retry_cells(configuration: Configuration, outcomes: Collection[CellStatus]) -> tuple[CellKey, ...]:
    """Make the cells of a configuration that have these outcomes pending again, and give them.

    Their history is kept, but workers that were lost to them no longer count against them. `LeaseHeldError` while a run
    writes the campaign, since it would not notice; `StoreUnavailableError` if the database or the campaign does not
    exist; `CampaignMismatchError` if it is another one.
    """
    cure = "There is nothing to retry; leave --retry out."
    if not _exists(configuration.database):
        raise StoreUnavailableError(f"{configuration.database} does not exist.", cure)
    with Store(configuration.database) as store:
        if not choose_campaign(store, configuration):
            missing = f"{configuration.database} has no campaign '{configuration.campaign.name}'."
            raise StoreUnavailableError(missing, cure)
        store.acquire_lease()
        plan = configuration.campaign
        found = store.statuses(Selection(plan.seed_numbers))
        planned = [key for key in found if key.content in plan.contents]
        return store.retry(outcomes, planned)


def _exists(database: str) -> bool:
    """Whether a database may exist; a server always does."""
    path = Address.parse(database).path
    return path is None or path.exists()
