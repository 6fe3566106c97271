"""What a process needs to run: beginning and end, pools, tasks, threads, waiting, a log and a terminal not flooded."""
