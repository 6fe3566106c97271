"""What a frame costs, counted: bytes that each pass moves and operations of blending; and what that takes on devices.

Bytes are reads and writes of buffers as the shaders state them, neighbours in a cache left out; gathers count whole
32-byte sectors. Operations are those of blending, which all others are small against. The estimate of a device takes a
quarter of its operations and 70 % of its bandwidth as reachable: an estimate, until a measurement replaces it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

OPERATIONS_A_VISIT, OPERATIONS_TO_FIND = 14, 3
"""Operations that a pixel spends on an entry, and to find it where it looks only at those of its quarter of a tile."""

OPERATIONS_AN_ENTRY = 100
"""To tell which quarters of its tile an entry touches, once for all their pixels."""

PIXELS_A_TILE, PIXELS_A_QUARTER = 256, 64
SECTOR_BYTES = 32
REACHED_OPERATIONS, REACHED_BANDWIDTH = 0.25, 0.7


@dataclass(frozen=True, slots=True)
class FrameCounts:
    """What a frame is made of."""

    splats: int
    visible: int  # that touch a tile
    box_entries: int  # tiles of the splats' boxes
    entries: int  # tiles that the ellipses touch
    quarters: int  # quarters of tiles that they touch
    pixels: int
    reference_pixels: int = 120_000
    harmonics: int = 0  # a channel, beyond the base colour
    stride: int = 2  # of the pixels that tell what hides what

    def scaled(self, splats: int) -> FrameCounts:
        """The same view of a scene of ``splats`` like it."""
        share = splats / self.splats
        grown = {name: round(getattr(self, name) * share) for name in ("visible", "box_entries", "entries", "quarters")}
        return replace(self, splats=splats, **grown)

    @property
    def tiles(self) -> int:
        """About as many as there are in an image of these pixels."""
        return -(-self.pixels // PIXELS_A_TILE)


@dataclass(frozen=True, slots=True)
class Design:
    """What can be done one way or the other; the defaults are how it is done."""

    ellipse: bool = True  # binning by the exact ellipse, else by its box
    digit_bits: int = 8  # of the radix sorts
    record_bytes: int = 32
    direct: bool = True  # entries name their splat; else a slot, which names it
    compact: bool = True  # the picture in 16 bits a channel until it is shown, else floats
    joined: bool = True  # alignment and correction in one pass that stores a depth and a pixel; else four floats twice
    quarters: bool = True  # a quarter of a tile looks at the entries that touch it, else at all of the tile's


PROTOTYPE = Design(
    ellipse=False, digit_bits=4, record_bytes=48, direct=False, compact=False, joined=False, quarters=False
)

STEPS: tuple[tuple[str, Design], ...] = (
    ("as prototyped", PROTOTYPE),
    ("exact ellipse in binning", replace(PROTOTYPE, ellipse=True)),
    ("digits of 8 bits", replace(PROTOTYPE, ellipse=True, digit_bits=8)),
    ("records of 32 bytes", replace(PROTOTYPE, ellipse=True, digit_bits=8, record_bytes=32)),
    ("entries name splats", replace(PROTOTYPE, ellipse=True, digit_bits=8, record_bytes=32, direct=True)),
    ("alignment joined with correction", Design(compact=False, quarters=False)),
    ("pictures of 16 bits", Design(quarters=False)),
    ("quarters of tiles", Design()),
)
"""The improvements one after the other."""


def pass_bytes(counts: FrameCounts, design: Design | None = None) -> dict[str, int]:
    """Bytes that each stage of a client's frame moves."""
    design = design or Design()
    n, seen = counts.splats, counts.visible
    entries = counts.entries if design.ellipse else counts.box_entries
    harmonics = 12 * counts.harmonics * seen
    picture = 8 if design.compact else 16
    stages = {
        # mean and logit, quaternion, scale of all; colours and records of what is seen; rank, key, tiles
        "project": (48 + 12) * n + (16 + design.record_bytes) * seen + harmonics,
        "sort splats": _sort_bytes(n, 32, design.digit_bits),
        "bin": 16 * n + SECTOR_BYTES * seen + (8 if design.direct else 12) * entries,
        "sort entries": _sort_bytes(entries, counts.tiles.bit_length(), design.digit_bits),
        "ranges": 4 * entries + 8 * counts.tiles,
        "blend": ((4 if design.direct else 8) + design.record_bytes) * entries + (4 + picture) * counts.pixels,
    }
    return stages | _correction_bytes(counts, picture, joined=design.joined)


def _sort_bytes(count: int, bits: int, digit_bits: int) -> int:
    """Keys twice and values once in, both out, a pass; and the histograms, four times touched."""
    histogram = 16 * (1 << digit_bits) * -(-count // 2048)
    return -(-bits // digit_bits) * (20 * count + histogram)


def _correction_bytes(counts: FrameCounts, picture: int, *, joined: bool) -> dict[str, int]:
    sampled = counts.pixels // counts.stride**2
    reference = (12 + 16) * counts.reference_pixels
    if joined:  # depth in, filled depth and place out; then picture, place, depth in, 8-bit colours out; place
        return {
            "expand": reference,
            "fill": 4 * counts.pixels,
            "place": 16 * counts.pixels + 8 * sampled,
            "add": (16 + picture) * counts.pixels,
            "surround": 8 * counts.pixels,
        }
    # alignment stores (x, y, z, inside), then aligned colours and confidence; correction reads those and the picture
    return {
        "expand": reference,
        "fill": 20 * counts.pixels,
        "place": 20 * counts.pixels + 16 * sampled,
        "resolve": 36 * counts.pixels,
        "add": (32 + picture) * counts.pixels,
    }


def read_back_bytes(counts: FrameCounts, *, in_one_go: bool) -> int:
    """Bytes that come down for a frame: what is shown and its confidence; else picture, opacity and depth."""
    return (4 if in_one_go else 20) * counts.pixels


def compared_bytes(counts: FrameCounts, *, in_one_go: bool) -> int:
    """Bytes that come down for a server's reference: the difference, before and after the compander; else two pictures
    with opacity. And the mirror's depth, and contributions.
    """
    return (28 if in_one_go else 36) * counts.reference_pixels + 4 * counts.splats


def visits(counts: FrameCounts, design: Design | None = None) -> int:
    """Pixels x splats that blending looks at, if no tile ended early."""
    design = design or Design()
    if design.quarters:
        return PIXELS_A_QUARTER * counts.quarters
    return PIXELS_A_TILE * (counts.entries if design.ellipse else counts.box_entries)


def operations(counts: FrameCounts, design: Design | None = None) -> int:
    """Operations of blending, if no tile ended early."""
    design = design or Design()
    looked = visits(counts, design)
    if not design.quarters:
        return OPERATIONS_A_VISIT * looked
    return (OPERATIONS_A_VISIT + OPERATIONS_TO_FIND) * looked + OPERATIONS_AN_ENTRY * counts.entries


@dataclass(frozen=True, slots=True)
class DeviceClass:
    """A kind of device by its data sheet."""

    name: str
    bytes_a_second: float
    operations_a_second: float
    target_ms: tuple[float, float]  # of a whole frame of 150,000 splats at 1600x1200


DEVICES = (
    DeviceClass("integrated GPU (Iris Xe)", 60e9, 2e12, (14.0, 18.0)),
    DeviceClass("phone, sustained", 40e9, 1e12, (25.0, 30.0)),
    DeviceClass("RTX 3080", 760e9, 30e12, (0.0, 2.0)),
)


def estimated_ms(counts: FrameCounts, device: DeviceClass, design: Design | None = None) -> float:
    """Milliseconds of a frame on a device of that class: moving and computing one after the other."""
    moved = sum(pass_bytes(counts, design).values()) / (REACHED_BANDWIDTH * device.bytes_a_second)
    computed = operations(counts, design) / (REACHED_OPERATIONS * device.operations_a_second)
    return 1e3 * (moved + computed)
