"""What a process needs to run: pools, tasks, threads, waiting, a log and a terminal that are not flooded."""
