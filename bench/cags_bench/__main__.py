"""``python -m cags_bench``."""

from cags_bench.cli import main

raise SystemExit(main())
