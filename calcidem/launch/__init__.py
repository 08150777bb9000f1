"""How a command starts ranks and hears of them, over sockets and on all hosts; knows neither batches nor MPI."""
