"""``python -m cags_encoder``: the command ``cags-encode``."""

import sys

from cags_common.runtime.entry import encode

sys.exit(encode())
