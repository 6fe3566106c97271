"""The one exception family of the program.

Every error that a user can cause derives from :class:`CagsError` and carries one clear line: the thing, its value, and
the way out. Commands print that line and exit; they never show a traceback for these.
"""

from __future__ import annotations


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
        return cls(f"{path}: cannot be written ({error.strerror or error}); choose another place")


class NetworkError(CagsError):
    """A connection could not be made, was refused, or went away."""
