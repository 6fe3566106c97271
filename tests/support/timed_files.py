"""Native 4D files, built in code as their methods write them."""

from __future__ import annotations

import json
import struct

import numpy as np

from cags_common.splats import SH_C0
from cags_encoder.formats.ply import MEANS, OPACITY, QUATS, SCALES, SH0
from cags_encoder.formats.ply_container import header_bytes
from cags_encoder.formats.spacetime_ply import MOTION, OMEGA, TIMES
from cags_encoder.formats.splatv import MAGIC, RECORD
from cags_encoder.formats.timed import TimedSplats
from support.splat_files import random_splats


def timed_splats(count: int = 50, seed: int = 0) -> TimedSplats:
    """Splats that come and go within a clip from 0 to 1, in curves."""
    rng = np.random.default_rng(seed)
    return TimedSplats(
        random_splats(count, 0, seed),
        rng.uniform(-0.1, 1.1, count),
        rng.uniform(0.05, 0.6, count),
        rng.normal(0, 0.5, (count, 3, 3)).astype(np.float32),
        rng.normal(0, 0.3, (count, 4)).astype(np.float32),
    )


def spacetime_ply_bytes(timed: TimedSplats, **instead: np.ndarray) -> bytes:
    """A PLY file as SpaceTime Gaussians' lite model saves it; ``instead`` replaces columns."""
    names = [*MEANS, *TIMES, "nx", "ny", "nz", *MOTION, *SH0, *OPACITY, *SCALES, *QUATS, *OMEGA]
    splats, n = timed.splats, len(timed)
    columns = dict(zip(MEANS, splats.means.T, strict=True))
    columns |= {"trbf_center": timed.centres, "trbf_scale": np.log(timed.widths)}
    columns |= dict(zip(MOTION, timed.motion.reshape(n, 9).T, strict=True))
    columns |= dict(zip(SH0, (0.5 + SH_C0 * splats.sh0).T, strict=True))
    columns |= {"opacity": splats.logit_opacities} | dict(zip(SCALES, splats.log_scales.T, strict=True))
    columns |= dict(zip(QUATS, splats.quats.T, strict=True)) | dict(zip(OMEGA, timed.omega.T, strict=True))
    columns |= instead
    table = np.stack([np.broadcast_to(columns.get(name, 0.0), n) for name in names], axis=1).astype("<f4")
    lines = [f"element vertex {n}", *(f"property float {name}" for name in names)]
    return header_bytes(lines) + table.tobytes()


def splatv_bytes(timed: TimedSplats, chunks: list[object] | None = None) -> bytes:
    """A ``.splatv`` file; ``chunks`` replaces its list of chunks."""
    splats, n = timed.splats, len(timed)
    rows = np.zeros(-(-n // 1024) * 1024, RECORD)  # the texture's last row is filled up
    used = rows[:n]
    used["mean"], used["quat"], used["scale"] = splats.means, splats.quats, np.exp(splats.log_scales)
    opacity = 1 / (1 + np.exp(-splats.logit_opacities[:, None].astype(np.float64)))
    colours = np.concatenate([0.5 + SH_C0 * splats.sh0, opacity], axis=1)
    used["rgba"] = np.clip(np.round(255 * colours), 0, 255)
    used["motion"], used["omega"] = timed.motion.reshape(n, 9), timed.omega
    used["time"] = np.stack([timed.centres, timed.widths], axis=1)
    listed = [{"type": "note", "size": 3}, {"type": "splat", "size": rows.nbytes, "texwidth": 4096, "cameras": []}]
    text = json.dumps(listed if chunks is None else chunks).encode()
    return struct.pack("<II", MAGIC, len(text)) + text + b"abc" + rows.tobytes()
