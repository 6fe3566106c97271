"""``python -m cags_server``."""

from cags_server.cli import main

raise SystemExit(main())
