"""``python -m cags_encoder``: the command ``cags-encode``."""

import sys

from cags_encoder.cli import main

sys.exit(main())
