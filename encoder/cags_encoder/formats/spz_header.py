"""The header of an ``.spz`` file, in either container."""

from __future__ import annotations

from dataclasses import dataclass

from cags_common.errors import SceneError
from cags_common.splats import SH_REST_OF_DEGREE
from cags_encoder.formats.files import check_count

MAGIC = 0x5053474E  # "NGSP"


@dataclass(frozen=True, slots=True)
class SpzHeader:
    """The first sixteen bytes of the file."""

    version: int
    count: int
    sh_degree: int
    fractional_bits: int

    @property
    def sections(self) -> tuple[tuple[str, int], ...]:
        """Name and bytes per splat of each section, in file order."""
        mean_bytes = 6 if self.version == 1 else 9
        quat_bytes = 4 if self.version >= 3 else 3
        sh_bytes = 3 * SH_REST_OF_DEGREE[self.sh_degree]
        return (("mean", mean_bytes), ("alpha", 1), ("colour", 3), ("scale", 3), ("quat", quat_bytes), ("sh", sh_bytes))


SMALL_COUNT = 1_000_000
"""A file that claims more splats must have at least one byte for each; real files have ten or more."""


def checked_header(
    version: int, count: int, sh_degree: int, fractional_bits: int, source: str, *, held_bytes: int
) -> SpzHeader:
    """The header of a file of ``held_bytes`` bytes, if its values are in range. Raises :class:`SceneError`."""
    if count > max(SMALL_COUNT, held_bytes):
        raise SceneError(
            f"{source}: claims {count} splats in {held_bytes} bytes, too few for that many; check the file"
        )
    if sh_degree > 3:
        raise SceneError(f"{source}: claims SH degree {sh_degree}; 0 to 3 are supported")
    if fractional_bits > 24:
        raise SceneError(f"{source}: claims {fractional_bits} fractional bits; the maximum is 24")
    return SpzHeader(version, check_count(count, source), sh_degree, fractional_bits)
