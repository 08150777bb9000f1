"""How a command starts and monitors ranks, over sockets and on all hosts; knows neither batches nor MPI."""
