"""The one exception family of the program.

Every error that a user can cause derives from :class:`CagsError` and carries one clear line: the thing, its value, and
the way out. Commands print that line and exit; they never show a traceback for these.
"""

from __future__ import annotations

import errno

REFUSALS = {
    errno.ENOSPC: "make room or choose another place",
    errno.EDQUOT: "make room or choose another place",
    errno.EFBIG: "allow larger files (ulimit -f) or choose another place",
    errno.EROFS: "choose another place",
    errno.EACCES: "choose another place or change its permissions",
    errno.EPERM: "choose another place or change its permissions",
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.EMFILE: "allow more open files (ulimit -n)",
    errno.ENFILE: "close other programs",
    errno.EIO: "check the disk",
}
"""What a system may refuse to anybody, and the way out; other errors of it are faults of this program."""


class CagsError(Exception):
    """Base of all errors that are reported in one line, without a traceback."""


class ConfigError(CagsError):
    """A setting has an unknown name or a value out of range. Commands exit with 2."""


class SceneError(CagsError):
    """A scene file is missing, malformed, empty, or holds values that cannot be drawn."""


class BundleError(CagsError):
    """A bundle is missing, damaged, or of a version that this program does not read."""


class DecodeError(CagsError):
    """A tile, codebook or video payload does not decode, or fails its CRC."""


class TraceError(CagsError):
    """A network or pose trace is missing or malformed."""


class ProtocolError(CagsError):
    """A peer broke the wire protocol."""


class OutputError(CagsError):
    """An output cannot be written."""

    @classmethod
    def of(cls, path: object, error: OSError) -> OutputError:
        """What the system said of ``path``."""
        way_out = REFUSALS.get(error.errno or 0, "choose another place")
        return cls(f"{path}: cannot be written ({error.strerror or error}); {way_out}")


class NetworkError(CagsError):
    """A connection could not be made, was refused, or went away."""
