"""Computes batches on MPI ranks, on an executor or in this process; needs only batches, a computation and a sink.

`run.run_sweep` hands out batches to an executor, `ranks` makes one of the MPI ranks, `workers` submits to any.
"""
