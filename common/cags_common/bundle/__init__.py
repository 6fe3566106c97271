"""The bundle: one encoded scene on a store, written once and read by ranges (``docs/bundle.md``)."""

from cags_common.bundle.index import FrameEntry, TileEntry
from cags_common.bundle.manifest import Manifest, Pruning
from cags_common.bundle.player import BundlePlayer, DecodedFrame
from cags_common.bundle.reader import BundleReader
from cags_common.bundle.source import SourceDelta, SourceFrame
from cags_common.bundle.writer import BundleWriter, TilePayloads
from cags_common.tiles.lod import LodLayer

__all__ = [
    "BundlePlayer",
    "BundleReader",
    "BundleWriter",
    "DecodedFrame",
    "FrameEntry",
    "LodLayer",
    "Manifest",
    "Pruning",
    "SourceDelta",
    "SourceFrame",
    "TileEntry",
    "TilePayloads",
]
