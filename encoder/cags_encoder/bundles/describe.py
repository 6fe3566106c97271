"""Describes the contents of a bundle, as one JSON object and as text."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np

from cags_common.bundle import BundleReader, FrameEntry
from cags_common.tiles.kinds import TileKind
from cags_common.tiles.svq import CodebookSet
from cags_common.words import counted
from cags_encoder.bundles.parts import byte_parts

Description = dict[str, Any]


def summarise(reader: BundleReader, url: str) -> Description:
    """The most important numbers of a bundle. Raises :class:`BundleError`."""
    manifest = reader.manifest
    entries = [reader.frame(index) for index in range(manifest.frames)]
    splats = _splats(entries[0])
    return {
        "out": url,
        "name": manifest.name,
        "frames": manifest.frames,
        "fps": manifest.fps,
        "groups": len(manifest.gof_starts),
        "kept_whole": manifest.kept_whole,
        "lods": manifest.lods,
        "codec": manifest.codec,
        "quantiser": manifest.quantiser,
        "sh_degree": manifest.sh_degree,
        "splats_first_frame": splats,
        "splats_sent": sum(_splats(entry) for entry in entries),
        "bytes_codebooks": len(reader.codebooks()),
        "bytes_tiles": sum(entry.size_bytes for entry in entries),
        "bytes_first_frame": entries[0].size_bytes,
        "bytes_first_frame_base": sum(tile.lod_bytes[0] for tile in entries[0].tiles),
        "bytes_a_splat": entries[0].size_bytes / max(splats, 1),
        "bytes_of": {kind.name.lower(): _bytes(entries, kind) for kind in TileKind},
        "bytes_source": sum(files.source.size_bytes for files in manifest.gofs),
        "pruning": asdict(manifest.pruning) if manifest.pruning else None,
        "tracks": asdict(manifest.tracks) if manifest.tracks else None,
    }


def describe(reader: BundleReader, url: str) -> Description:
    """:func:`summarise`, with every frame, LoD and codebook. Raises :class:`BundleError`."""
    manifest, quality = reader.manifest, reader.quality()
    entries = [reader.frame(index) for index in range(manifest.frames)]
    layers = ["base", *(f"{item.attribute} {item.layer}" for item in manifest.lod_order)]
    gains = [None, *manifest.lod_gains_db] if manifest.lod_gains_db else [None] * manifest.lods
    first, every = _lod_bytes(entries[:1], manifest.lods), _lod_bytes(entries, manifest.lods)
    return {
        **summarise(reader, url),
        "levels": [
            {
                "lod": lod,
                "adds": layers[lod],
                "first_frame_bytes": first[lod],
                "bytes": every[lod],
                "gain_db": gains[lod],
            }
            for lod in range(manifest.lods)
        ],
        "each_frame": [
            {
                "frame": entry.frame,
                "key": entry.keyframe,
                "tiles": len(entry.tiles),
                "splats": _splats(entry),
                "removed": entry.removed_count,
                "bytes": entry.size_bytes,
            }
            for entry in entries
        ],
        "bytes_by_part": byte_parts(reader) if manifest.codec == "svq" else {},
        "codebooks": _codebooks(reader),
        "quality": asdict(quality) if quality else None,
    }


def lines(found: Description) -> Iterator[str]:
    """:func:`describe` as text."""
    frames, groups = counted(found["frames"], "frame"), counted(found["groups"], "group")
    if found["groups"] > 1:
        groups += " that clients keep" if found["kept_whole"] else " that clients drop when they are past"
    yield (
        f"{found['out']}: {found['name']!r}, {frames} at {found['fps']:g} fps in {groups}, "
        f"SH degree {found['sh_degree']}, codec {' '.join(filter(None, (found['codec'], found['quantiser'])))}"
    )
    later = [frame for frame in found["each_frame"] if not frame["key"]]
    yield (
        f"first frame: {counted(found['splats_first_frame'], 'splat')}, {found['bytes_first_frame']} bytes "
        f"({found['bytes_a_splat']:.2f} a splat); codebooks {found['bytes_codebooks']}; "
        f"tiles {found['bytes_tiles']}; source {found['bytes_source']}"
    )
    if later:
        sent, size = (float(np.mean([frame[name] for frame in later])) for name in ("splats", "bytes"))
        yield f"later frames: {sent:.0f} splats, {size:.0f} bytes each on average"
    moving = {name: sizes for name, sizes in found["bytes_of"].items() if name != "looks" and sizes}
    for name, sizes in moving.items():
        yield f"{name} tiles: {sum(sizes)} bytes in total, {sizes[0]} in level 0"
    for name, parts in found["bytes_by_part"].items():
        yield f"{name} after key frames: {', '.join(f'{part} {size}' for part, size in parts.items())}"
    if found["tracks"]:
        yield from _track_lines(found["tracks"])
    if found["pruning"]:
        pruned = found["pruning"]
        yield (
            f"pruned: {pruned['splats_before']} to {pruned['splats_after']} splats; PSNR of renders: "
            f"{pruned['psnr_db']:.2f} dB, SSIM {pruned['ssim']:.4f}"
        )
    yield ""
    yield from _level_lines(found)
    yield ""
    yield f"{'codebook':>14} {'dim':>4} {'bits':>5}  layers"
    for book in found["codebooks"]:
        yield f"{book['attribute']:>14} {book['dim']:>4} {sum(book['layer_bits']):>5}  {book['layer_bits']}"
    if found["quality"]:
        yield ""
        yield from _layer_lines(found["quality"]["layers"])


def _track_lines(tracks: Description) -> Iterator[str]:
    yield (
        f"tracks: {tracks['tracks']}, seen in {tracks['life_mean_frames']:.1f} frames on average; "
        f"{tracks['linked_share']:.1%} of a frame's splats continue"
    )
    lives = (f"{1 << k}+: {count}" for k, count in enumerate(tracks["life_histogram"]) if count)
    yield f"lifetimes in frames: {', '.join(lives)}"
    if tracks["linked_share"]:
        changed = (f"{name} {share:.1%}" for name, share in tracks["changed"].items())
        yield f"visible changes from frame to frame: {', '.join(changed)}"


def _level_lines(found: Description) -> Iterator[str]:
    yield "bytes of each level, without motion:"
    yield f"{'LoD':>4} {'adds':>16} {'first frame':>12} {'all frames':>12} {'PSNR dB':>8} {'SSIM':>7}"
    ladder = found["quality"]["ladder"] if found["quality"] else []
    for level in found["levels"]:
        seen = ladder[level["lod"]] if level["lod"] < len(ladder) else None
        quality = f"{seen['psnr_db']:>8.2f} {seen['ssim']:>7.4f}" if seen else f"{'-':>8} {'-':>7}"
        yield f"{level['lod']:>4} {level['adds']:>16} {level['first_frame_bytes']:>12} {level['bytes']:>12} {quality}"


def _layer_lines(layers: list[Description]) -> Iterator[str]:
    yield "fewer layers of one attribute, all layers of the others:"
    yield f"{'attribute':>14} {'layers':>6} {'bytes':>9} {'PSNR dB':>8} {'SSIM':>7}"
    for row in layers:
        place = f"{row['attribute']:>14} {row['layer']:>6} {row['size_bytes']:>9}"
        yield f"{place} {row['psnr_db']:>8.2f} {row['ssim']:>7.4f}"


def _splats(entry: FrameEntry) -> int:
    """Number of splats sent whole, new or again."""
    return sum(tile.splats for tile in entry.tiles if tile.kind == TileKind.LOOKS)


def _bytes(entries: list[FrameEntry], kind: TileKind) -> list[int]:
    """Bytes of each level of all tiles of ``kind``; empty where there are none."""
    sizes = [tile.lod_bytes for entry in entries for tile in entry.tiles if tile.kind == kind]
    return [sum(level) for level in zip(*sizes, strict=True)]


def _lod_bytes(entries: list[FrameEntry], lods: int) -> list[int]:
    """Bytes that each level of looks and of updates adds in ``entries``."""
    both = [sizes for kind in (TileKind.LOOKS, TileKind.UPDATE) if (sizes := _bytes(entries, kind))]
    return [sum(level) for level in zip(*both, strict=True)] if both else [0] * lods


def _codebooks(reader: BundleReader) -> list[Description]:
    if reader.manifest.codec != "svq":
        return []
    return [
        {"attribute": book.attribute, "dim": book.tables[0].shape[1], "layer_bits": list(book.layer_bits)}
        for book in CodebookSet.from_bytes(reader.codebooks())
    ]
