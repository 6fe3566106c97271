"""The comparison: all LoDs of the quantisers and the other formats, scene by scene."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

from cags_bench.codec.ablation import VARIANTS, Variant, gains
from cags_bench.codec.checks import DEFAULT, checks
from cags_bench.codec.ladder import LadderSettings, ladder, median_ms
from cags_bench.codec.peers import Peer, peers
from cags_bench.codec.readers import SplatTransform
from cags_bench.codec.scaling import scaling
from cags_bench.codec.views import Judge, views_around
from cags_bench.inputs import check_scenes
from cags_bench.jsonl import summary
from cags_common.lpips import Lpips
from cags_common.raster import create
from cags_common.splats import Splats
from cags_common.tiles.morton import morton_order
from cags_encoder.scenes import open_scene

Line = dict[str, Any]


def compare(scenes: Sequence[str], options: argparse.Namespace) -> Iterator[Line]:
    """Lines of every scene, then the summary.

    Raises :class:`CagsError`; wrong inputs are refused before anything is measured.
    """
    variants = [Variant.named(name) for name in options.quantisers]
    check_scenes([*scenes, *([options.clip] if options.clip else [])])
    lpips = Lpips(options.lpips) if options.lpips else None
    tool = SplatTransform.find(options.splat_transform)
    settings = LadderSettings(options.points, options.repeats, options.threads)
    seen: list[Line] = []
    for spec in scenes:
        source = open_scene(spec)
        splats = source.frame(0)
        splats = splats.take(morton_order(splats.means))
        judge = Judge(splats, views_around(source, options.views, options.width), create("auto"), lpips)
        known = {"scene": spec, "sh_degree": splats.sh_degree}
        for variant in [*variants, *(VARIANTS if options.ablations else ())]:
            for line in ladder(source, splats, variant, judge, settings):
                seen.append({**known, **line})
                yield seen[-1]
        yield from gains(seen, spec, DEFAULT)
        if isinstance(tool, str):
            yield {**known, "codec": "sog", "skipped": tool}
        for peer in peers(splats, None if isinstance(tool, str) else tool):
            seen.append({**known, **_point(splats, peer, judge, options.repeats)})
            yield seen[-1]
    if options.clip:
        for line in scaling(options.clip, options.clip_frames, options.workers):
            seen.append(line)
            yield line
    yield summary("codec", checks(seen), scenes=list(scenes), views=options.views, threads=options.threads)


def _point(splats: Splats, peer: Peer, judge: Judge, repeats: int) -> Line:
    data = peer.encode(splats)
    return {
        "codec": peer.name,
        "splats": len(splats),
        "bytes": len(data),
        "bytes_a_splat": len(data) / len(splats),
        **asdict(judge(peer.decode(data))),
        "encode_ms": median_ms(partial(peer.encode, splats), 1),
        "decode_ms": median_ms(partial(peer.decode, data), repeats),
        "reader_ms": {name: read(data, repeats) for name, read in peer.readers.items()},
    }
