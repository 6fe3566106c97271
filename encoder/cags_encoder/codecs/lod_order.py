"""Linear LoD orders: the paper's, and orders from files."""

from __future__ import annotations

from pathlib import Path

from cags_common.errors import BundleError, ConfigError
from cags_common.tiles.lod import LodLayer, check_order
from cags_common.tiles.svq import CodebookSet

NAMED_ORDERS = ("measured", "paper")
"""Values of the setting that name no file."""

# Position of an attribute's first layer, in layers after the first of scale. Coarse scales tear surfaces apart; errors
# of rotations are the next most visible, then colours, then opacity (paper, supplement, "LoD Assignment").
_LATENESS = {
    "scale": 0.0,
    "rotation_imag": 1.0,
    "rotation_real": 1.1,
    "rotation": 1.0,
    "sh0": 1.2,
    "sh1": 1.9,
    "opacity": 2.0,
    "alpha": 2.0,
    "sh2": 2.9,
    "sh3": 3.9,
}


def paper_order(books: CodebookSet) -> tuple[LodLayer, ...]:
    """Layers interleaved by the impact that the paper reports: scale, rotation, SH, opacity."""
    layers = [LodLayer(book.attribute, layer) for book in books for layer in range(1, book.enhancement_layers + 1)]
    return tuple(sorted(layers, key=lambda item: item.layer + _LATENESS[item.attribute]))


def order_of(name: str, books: CodebookSet) -> tuple[LodLayer, ...]:
    """The order named by a setting: ``paper`` or a file of lines ``attribute layer``. Raises :class:`ConfigError`.

    For ``measured``, the paper's order is the initial one.
    """
    if name in NAMED_ORDERS:
        return paper_order(books)
    order = order_in_file(name)
    try:
        check_order(order, {book.attribute: book.enhancement_layers for book in books})
    except BundleError as error:
        raise ConfigError(f"{name}: {error}") from error
    return order


def order_in_file(name: str) -> tuple[LodLayer, ...]:
    """The order in the file ``name``, not compared with the codebooks' layers. Raises :class:`ConfigError`."""
    path = Path(name)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(
            f"lod_order = {name!r} is not 'measured' or 'paper' and cannot be read as a file ({error})"
        ) from error
    order = []
    for number, line in enumerate(lines, start=1):
        words = line.split("#")[0].split()
        if not words:
            continue
        if len(words) != 2 or not words[1].isdecimal():
            raise ConfigError(f"{path}:{number}: {line!r} must be 'attribute layer', like 'scale 1'")
        order.append(LodLayer(words[0], int(words[1])))
    return tuple(order)
