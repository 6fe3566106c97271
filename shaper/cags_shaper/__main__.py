"""``python -m cags_shaper``."""

from cags_shaper.cli import main

raise SystemExit(main())
