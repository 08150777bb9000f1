"""One campaign from its configuration to its database, in one process or by the workers of an executor."""

import os
import platform
import sys
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from itertools import starmap
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Protocol, Self, TypeVar

import numpy as np

from calcidem.app.campaign.cells import CellComputation, SeedDemand, batches_of, kernel_compilations, planned_cells
from calcidem.app.campaign.packing import packing_record, provide_packing, stored_packing
from calcidem.app.campaign.status import (
    STATUS_QUANTITIES,
    CampaignStatus,
    ProgressDisplay,
    ProgressReporter,
    RunProgress,
    RunStage,
    choose_display,
)
from calcidem.app.config.checks import check_against_packing
from calcidem.app.config.schema import Configuration, choose_campaign
from calcidem.dem.kernels.gpu import gpu_card
from calcidem.dem.sample.cement import GIVEN, Pattern
from calcidem.dem.sample.packing import Packing, PackingStage
from calcidem.ends import DECIDED_BY_PHYSICS, CellStatus
from calcidem.storage.errors import (
    ForeignDatabaseError,
    LeaseHeldError,
    StoreError,
    StoreLockedError,
    StoreUnavailableError,
)
from calcidem.storage.records import AttemptCount, CellKey, CellResult, RunRecord, Selection
from calcidem.storage.sql.engine import Address
from calcidem.storage.sql.store import Store, read_campaign
from calcidem.sweep.ranks import COMMAND_VARIABLE, keep_freed_memory, mpi_library_version, refuse_singletons
from calcidem.sweep.run import run_sweep
from calcidem.sweep.schedule import (
    EXIT_RESUMABLE,
    LOSSES_BEFORE_QUARANTINE,
    Batch,
    BatchOutcome,
    Cell,
    LaunchError,
    StopLevel,
    StopRequest,
    SweepEnd,
    SweepInterrupted,
    SweepState,
    WorkersLostError,
)
from calcidem.version import __version__, source_commit
from calcidem.wording import advise, tell

if TYPE_CHECKING:
    from calcidem.app.campaign.opened import Campaign  # for statistics, which the ranks do not need


def run(
    configuration: Configuration | str | os.PathLike[str],
    *,
    db: str | os.PathLike[str] | None = None,
    output: str | os.PathLike[str] | None = None,
    set: Mapping[str, object] | None = None,  # noqa: A002 - reads as what it does: run(..., set={"wave.damping": 0.2})
    progress: Callable[[RunProgress], object] | bool | None = None,
    executor: Executor | None = None,
    patterns: Mapping[str, Pattern] | None = None,
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
    patterns
        Patterns of cement by the names that ``pattern.drawn_by`` may have, beside those of installed packages
        (docs/how-to/extend.md). A name stands for one function, since it is part of the campaign's identity.

    Returns
    -------
    Campaign
        Opened for reading; close it after use. Its `notes` have what the run has warned of (`CampaignWarning`).

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

    GIVEN.update(patterns or {})
    values = dict(set or {})
    values |= {"run.database": os.fspath(db)} if db is not None else {}
    values |= {"run.output": os.fspath(output)} if output is not None else {}
    if values or not isinstance(configuration, Configuration):
        configuration = change_configuration(configuration, values)
    keep_freed_memory()
    with choose_display(progress) as display:
        reporter = ProgressReporter(display)
        with CampaignRun(configuration, watch=reporter.on_packing) as work:
            # Not set by signals: an interrupt goes to the caller.
            end = work.compute(executor, reporter, StopRequest())
            if end.state is not SweepState.COMPLETE:
                raise WorkersLostError(f"{end.detail} (everything stored is safe)")
            for line in work.demand.lines() if work.demand else ():
                tell(line)
    campaign = open_campaign(configuration.database, configuration.campaign.name)
    for note in campaign.notes:
        advise(note)
    return campaign


class RunView(Protocol):
    """Output and progress of a run; its sentences are log records (`calcidem.wording`)."""

    def display(self) -> ProgressDisplay:
        """Receiver of the progress."""

    def begin(self, configuration: Configuration, packing: Packing) -> None:
        """Describe the coming computation."""

    def finish(self, store: Store, configuration: Configuration, code: int, *, in_haste: bool) -> None:
        """Report the results and write files; at an urgent end only what takes no time."""

    def refuse(self, error: Exception) -> int:
        """Report an error that the user can remedy and return its exit code; raise any other."""


def run_command_line(
    load: Callable[[], Configuration], view: RunView, executor: Executor | None, stop_request: StopRequest
) -> int:
    """Compute a campaign, or its missing cells, for the command line; return the exit code."""
    keep_freed_memory()
    with view.display() as display:
        reporter = ProgressReporter(display)
        work = None
        try:
            if executor is None:
                refuse_singletons()
            work = CampaignRun(load(), stop_request.raise_if_stopped, reporter.on_packing)
            with work:
                view.begin(work.configuration, work.packing)
                end = work.compute(executor, reporter, stop_request)
                reporter.begin(RunStage.WRITING, "tables and files")
                view.finish(work.store, work.configuration, end.exit_code, in_haste=stop_request.hurry())
                return end.exit_code
        except SweepInterrupted:
            tell(f"{stop_request.explanation}: ended before the cells; run it again to continue.")
            return EXIT_RESUMABLE
        except Exception as error:  # noqa: BLE001 - the view raises again what is not the user's to cure
            code = view.refuse(error)
            # After a restart a server has all stored data.
            is_lost = isinstance(error, StoreUnavailableError) and work is not None and work.end is not None
            return EXIT_RESUMABLE if is_lost else code


@contextmanager
def dask_executor(address: str) -> Iterator[Executor]:
    """Connect to a scheduler; at the end cancel batches not yet begun.

    `LaunchError` if no scheduler answers at the address, or Dask is not installed.
    """
    try:
        from distributed import Client  # noqa: PLC0415 - an extra of the package
    except ImportError as error:
        raise LaunchError(f"--dask {address}: Dask is missing ({error}); pip install 'calcidem[dask]'") from error
    try:
        client = Client(address, timeout=10.0, set_as_default=False)
    except (OSError, ValueError) as error:  # a time-out is an OSError
        raise LaunchError(
            f"--dask {address}: no scheduler answers there ({error}); give the address that `dask scheduler` writes, "
            "like tcp://host:8786"
        ) from error
    try:
        yield client.get_executor(pure=False)
    finally:
        with suppress(Exception):  # any error is harmless: the outcomes are stored and the client is no longer needed
            client.close(timeout=3.0)  # s; it cancels running batches, and a dead scheduler does not answer


@contextmanager
def prepared_store(
    configuration: Configuration, raise_if_stopped: Callable[[], None], watch: Callable[[PackingStage], None]
) -> Iterator[tuple[Store, Packing]]:
    """Store of a campaign with its packing and its planned cells, of which this process is the only writer.

    An existing database is checked before the packing is made, so that one of another campaign is refused at once. A
    new database or campaign is created after the packing, so that a configuration that the packing cannot fulfil
    creates none.
    `GpuError` if `run.gpu` asks for a GPU that is not here.
    """
    if configuration.run.gpu:
        gpu_card().refuse_missing()
    is_known = False
    if _exists(configuration.database):  # an empty one is refused for reading, and new for writing
        with suppress(ForeignDatabaseError), Store(configuration.database, read_only=True) as stored:
            is_known = choose_campaign(stored, configuration)
            if is_known and stored.packing_indices():
                check_against_packing(configuration, stored_packing(stored.packing(), configuration.packing_hash))
    store = _become_master(configuration, raise_if_stopped) if is_known else None
    sink = None if store is None else StoreSink(store, ())

    def keep_alive() -> None:  # a packing may take longer than a lease lasts
        raise_if_stopped()
        if sink is not None:
            sink.keep_alive()

    try:
        packing = provide_packing(configuration, store, keep_alive, watch)
        doubts = check_against_packing(configuration, packing)
        if COMMAND_VARIABLE not in os.environ:  # which has said it before it started the ranks
            from calcidem.app.campaign.preview import wave_doubts  # noqa: PLC0415 - which loads the launcher

            for doubt in (*doubts, *wave_doubts(configuration, packing)):
                advise(f"{doubt}.")
        configuration.output.mkdir(parents=True, exist_ok=True)
        store = store or _become_master(configuration, raise_if_stopped)
        store.save_packing(packing_record(packing, index=0, packing_hash=configuration.packing_hash))
        store.extend(configuration.campaign.seed_numbers, configuration.campaign.contents)
        yield store, packing
    finally:
        if store is not None:
            with suppress(StoreError):  # the last write has reported a lost database
                store.close()


class CampaignRun:
    """A campaign that is being computed: its store, packing and remaining batches.

    As a context manager it closes the database and records the end of the run.

    Parameters
    ----------
    configuration
        Configuration to compute.
    raise_if_stopped
        Called every fraction of a second while the packing is made; may raise to end it.
    watch
        Called as often with the progress.

    Attributes
    ----------
    packing, store
        Packing and store of the campaign.
    demand
        Numbers of seeds that each content needs; None without `until` in the configuration.
    end
        Of the sweep; None before it.
    """

    def __init__(
        self,
        configuration: Configuration,
        raise_if_stopped: Callable[[], None] = lambda: None,
        watch: Callable[[PackingStage], None] = lambda _: None,
    ) -> None:
        self.configuration = configuration
        self.end: SweepEnd | None = None
        self.demand: SeedDemand | None = None
        self._closing = ExitStack()
        self.store, self.packing = self._closing.enter_context(prepared_store(configuration, raise_if_stopped, watch))

    def compute(self, executor: Executor | None, reporter: ProgressReporter, stop_request: StopRequest) -> SweepEnd:
        """Have the missing cells computed and store the outcomes; None computes in this process.

        `StoreError` if the database is no longer there, or was damaged meanwhile: then nothing is complete.
        """
        workers = getattr(executor, "num_workers", None)
        self.store.begin_run(describe_run(1 if workers is None else workers + 1))
        try:
            batches = self._plan_batches()
            reporter.read = partial(read_own_status, self.configuration)
            if batches and executor is None:
                reporter.begin(RunStage.COMPILING)
                for compile_kernel in kernel_compilations(self.configuration, self.packing, reporter.on_compiling):
                    if stop_request.level is StopLevel.NONE:
                        compile_kernel()
            self.end = run_sweep(
                executor,
                batches,
                CellComputation(self.configuration, self.packing),
                self._sink,
                time_limit=self.configuration.run.time_limit,
                progress=reporter,
                stop_request=stop_request,
                more=self._more,
            )
            self.store.renew_lease()
            self.store.refuse_damaged()
        except KeyboardInterrupt:
            self.end = SweepEnd(SweepState.STOPPED, "interrupted")
            raise
        except BaseException as error:
            self.end = SweepEnd(SweepState.ERROR, f"{type(error).__name__}: {error}")
            raise
        return self.end

    def _plan_batches(self) -> tuple[Batch[Cell], ...]:
        """Plan the cells; return the batches of those without an outcome, in the order of computation."""
        plan = self.configuration.campaign
        self._quarantine_deadly()  # first, since the number of seeds depends on the outcomes
        if plan.until is None:
            own = planned_cells(self.configuration)
        else:
            self.demand = SeedDemand.of_store(self.store, plan)
            own = set(self.demand.cells)
            self.store.plan(starmap(CellKey, own))
        self.store.use_campaign(plan.name)  # with the whole plan
        pending = [key for key in self.store.pending(contents=plan.contents) if (key.seed, key.content) in own]
        self._sink = StoreSink(self.store, pending)
        self._losses = self._sink.losses
        if stored := self._sink.repeat_stored():
            pending = [key for key in pending if key not in stored]
        return batches_of(self.configuration, {(key.seed, key.content) for key in pending}, self._losses)

    def _quarantine_deadly(self) -> None:
        """Store an outcome of the cells that were being computed at too many deaths."""
        counts = self.store.attempt_counts()
        deadly = {key for key, count in counts.items() if count.losses >= LOSSES_BEFORE_QUARANTINE}
        if not deadly:
            return
        pending = set(self.store.pending(contents=self.configuration.campaign.contents))
        deadly &= pending
        if any(key.content == 0.0 for key in deadly):  # which are the same sample
            deadly |= {key for key in pending if key.content == 0.0}
        reason = f"{LOSSES_BEFORE_QUARANTINE} runs died while it was computed, so it is not tried again"
        self.store.record_results(
            CellResult(key, CellStatus.QUARANTINED, reason, attempt=counts.get(key, AttemptCount()).attempts + 1)
            for key in deadly
        )
        for key in sorted(deadly):
            tell(f"quarantined: {key}: {reason}")

    def _more(self, outcomes: Sequence[BatchOutcome[Cell, CellResult]]) -> tuple[Batch[Cell], ...]:
        """Further batches that the outcomes require, if the configuration has `until`."""
        if self.demand is None:
            return ()
        cells = self.demand.take_in(outcomes)
        self._sink.plan(starmap(CellKey, cells))
        return batches_of(self.configuration, cells, self._losses)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        """Record the end and close the database."""
        try:
            if self.end is not None:
                detail = f": {self.end.detail}" if self.end.detail else ""
                with suppress(StoreError):  # the last write has reported a lost database
                    cut_off = self.end.state is SweepState.CUT_OFF
                    self.store.end_run(f"{self.end.state}{detail}", datetime.now(UTC), cut_off=cut_off)
        finally:
            self._closing.close()


def read_own_status(configuration: Configuration) -> CampaignStatus:
    """Read the progress of the cells that a configuration plans; `StoreError` if the database is unreadable."""
    plan = configuration.campaign
    seeds = plan.seed_numbers if plan.until is None else None
    with read_campaign(configuration.database, plan.name) as store:
        columns = store.table(STATUS_QUANTITIES, Selection(seeds, plan.contents))
        if configuration.run.part is not None:
            own = planned_cells(configuration)
            cells = zip(columns["seed"].tolist(), columns["content"].tolist(), strict=True)
            chosen = np.array([cell in own for cell in cells], dtype=bool)
            columns = {name: values[chosen] for name, values in columns.items()}
        return CampaignStatus.of(store, columns, ())


def _become_master(configuration: Configuration, raise_if_stopped: Callable[[], None]) -> Store:
    """Open the database and become the only writer of this campaign."""
    path = Address.parse(configuration.database).path
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
    store = Store(configuration.database)
    try:
        store.begin_campaign(configuration.record())
        for sentence in _acquire_lease(store, raise_if_stopped):
            tell(sentence)
    except BaseException:
        store.close()
        raise
    return store


def _acquire_lease(store: Store, raise_if_stopped: Callable[[], None]) -> tuple[str, ...]:
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
        raise_if_stopped()
        time.sleep(1.0)


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
        for sentence in store.acquire_lease():
            tell(sentence)
        plan = configuration.campaign
        found = store.statuses(Selection(None if plan.until is not None else plan.seed_numbers))
        planned = [key for key in found if key.content in plan.contents]
        return store.retry(outcomes, planned)


def _exists(database: str) -> bool:
    """Whether a database may exist; a server always does."""
    path = Address.parse(database).path
    return path is None or path.exists()


T = TypeVar("T")

LONGEST_WAIT = timedelta(minutes=10)
"""Longest wait for a lock of another process."""


class StoreSink:
    """`calcidem.sweep.run.Sink` that writes into a store.

    Parameters
    ----------
    store
        Store with the campaign chosen.
    keys
        Cells without an outcome; of those without cement one is computed.
    """

    def __init__(self, store: Store, keys: Sequence[CellKey]) -> None:
        self._store = store
        self.busy = Lock()
        """Lock held while a thread uses the store."""
        self.patience = LONGEST_WAIT.total_seconds()
        self._next_renewal = 0.0
        self._counts = store.attempt_counts(keys) if keys else {}
        self._bare = [key for key in keys if key.content == 0.0]
        self._running: set[CellKey] = set()
        self._unplanned: deque[CellKey] = deque()

    @property
    def losses(self) -> dict[Cell, int]:
        """Number of earlier runs that died while each cell was computed."""
        return {(key.seed, key.content): count.losses for key, count in self._counts.items()}

    def plan(self, keys: Iterable[CellKey]) -> None:
        """Plan cells in the transaction of the next stored outcomes; does not wait."""
        self._unplanned.extend(keys)

    def repeat_stored(self) -> set[CellKey]:
        """Store cells without cement as an earlier run computed their common sample; return them."""
        if self._bare:
            done = Selection(contents=0.0, statuses=DECIDED_BY_PHYSICS)
            computed = next(self._store.results(done, with_arrays=True), None)
            repeated = [] if computed is None else self._repetitions(computed.pack())
            self._store.record_results(repeated)
            return {result.key for result in repeated}
        return set()

    def mark(self, batches: Sequence[Batch[Cell]], /) -> None:
        """Begin an attempt for each cell of these batches; a batch that is computed again is marked already."""
        self._plan_further()
        keys = [key for batch in batches for cell in batch.cells if (key := CellKey(*cell)) not in self._running]
        self._counts |= self._with_patience(lambda: self._store.record_running(keys))
        self._running.update(keys)

    def store(self, outcomes: Sequence[BatchOutcome[Cell, CellResult]], /) -> None:
        """Write the outcomes in one transaction."""
        self._plan_further()
        results = [result for outcome in outcomes for result in self._results(outcome)]
        self._with_patience(lambda: self._store.record_results(results))
        for result in results:
            losses = self._counts.get(result.key, AttemptCount()).losses
            self._counts[result.key] = AttemptCount(result.attempt, losses)
            self._running.discard(result.key)

    def keep_alive(self) -> None:
        """Renew the lease if due, for other machines; storing outcomes also renews it."""
        if time.monotonic() > self._next_renewal and self.busy.acquire(blocking=False):
            try:
                self._next_renewal = time.monotonic() + 30.0  # s, half of the interval that the store requires
                with suppress(StoreLockedError):  # a process with the lock cannot take the lease meanwhile
                    self._store.renew_lease()
            finally:
                self.busy.release()

    def _plan_further(self) -> None:
        if new := [self._unplanned.popleft() for _ in range(len(self._unplanned))]:
            self._with_patience(lambda: self._store.plan(new))

    def _with_patience(self, write: Callable[[], T]) -> T:
        """Write, and wait while another process has locked the database, so that no computed cell is lost.

        `StoreLockedError` if the lock remains for longer than `patience`.
        """
        deadline = time.monotonic() + self.patience
        with self.busy:
            while True:
                try:
                    return write()
                except StoreLockedError as error:  # after half a minute in which SQLite itself has waited
                    if time.monotonic() > deadline:
                        raise
                    tell(f"Waiting for another process that has locked the database ({error.problem})")
                    time.sleep(1.0)

    def _results(self, outcome: BatchOutcome[Cell, CellResult]) -> list[CellResult]:
        found = list(outcome.results or ())
        if outcome.failure is not None:
            seconds = outcome.seconds / len(outcome.batch.cells)
            reason = f"{outcome.failure.message}\n{outcome.failure.traceback}".strip()
            keys = [CellKey(*cell) for cell in outcome.batch.cells]
            found = [CellResult(key, outcome.failure.kind, reason, seconds=seconds) for key in keys]
        found = [
            replace(result, rank=outcome.rank, host=outcome.host, attempt=self._attempt_of(result.key))
            for result in found
        ]
        return found + [
            repeated for result in found if result.key.content == 0.0 for repeated in self._repetitions(result)
        ]

    def _repetitions(self, computed: CellResult) -> list[CellResult]:
        """Outcome of a sample without cement for the other seeds to be stored, which are the same sample.

        They have no computing time, rank or host, and a velocity with the reason that it is that of another seed.
        """
        told = computed.reason or f"without cement all seeds are one sample, computed as seed {computed.key.seed}"
        common = replace(computed, reason=told, seconds=None, rank=None, host=None)
        return [replace(common, key=key, attempt=self._attempt_of(key)) for key in self._bare if key != computed.key]

    def _attempt_of(self, key: CellKey) -> int:
        """Number of the attempt that gave an outcome: of the one that was marked, or the next."""
        return self._counts.get(key, AttemptCount()).attempts + (key not in self._running)


def describe_run(ranks: int) -> RunRecord:
    """Provenance of a run that begins now, on rank 0 of this number of ranks."""
    commit, dirty = source_commit()
    versions = {"python": platform.python_version(), "calcidem": __version__}
    for name in ("numpy", "scipy", "numba", "llvmlite", "mpi4py", "sqlalchemy"):  # for numbers and files
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = ""
    model = ""
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
    if any(platform.libc_ver()):
        versions["libc"] = " ".join(platform.libc_ver())
    return RunRecord(
        versions=versions,
        host=platform.node(),
        cpu=model or platform.machine(),
        ranks=ranks,
        launch_line=" ".join(sys.argv),
        started=datetime.now(UTC),
        mpi_library=mpi_library_version() if ranks > 1 else None,
        git_commit=commit,
        git_dirty=dirty,
        slurm_job_id=os.environ.get("SLURM_JOB_ID"),
    )
