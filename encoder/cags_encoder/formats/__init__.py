"""Files of splats: one module a format, bytes in, checked :class:`~cags_common.splats.Splats` out."""

from cags_encoder.formats.registry import FORMATS, Format, detect_format, read_splats, write_splats

__all__ = ["FORMATS", "Format", "detect_format", "read_splats", "write_splats"]
