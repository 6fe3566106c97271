"""``python -m cags_client``."""

from cags_client.cli import main

raise SystemExit(main())
