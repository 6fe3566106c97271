"""What exists to be compared with: the paper's networks and their training, rival codecs, other policies and aligners.

Nothing below the benchmarks imports this package: what it holds is registered as entry points
(:mod:`cags_common.registry`) and found by name. The networks and their training need the extra ``research``.
"""
