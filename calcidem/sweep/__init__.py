"""Computes batches on MPI ranks, on an executor or in this process; needs only batches, a computation and a sink.

with Session() as session:
    ...                                     # prepare, session.broadcast(...)
    end = run_sweep(executor, batches, compute, sink)
    session.end(end.exit_code, end)
"""
