"""A command starts ranks and monitors them over sockets, on all hosts; independent of batches and MPI."""
