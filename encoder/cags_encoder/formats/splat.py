"""The ``.splat`` format of antimatter15's viewer: 32 bytes per splat, SH degree 0, no header.

Position 3 float32, linear scale 3 float32, colour and opacity 4 bytes, rotation ``wxyz`` 4 bytes as (b - 128) / 128.
Described by https://github.com/antimatter15/splat
"""

from __future__ import annotations

import numpy as np

from cags_common.errors import SceneError
from cags_common.splats import SH_C0, Splats
from cags_encoder.formats.files import bytes_of_logits, check_count, directed, log_of_scales, logit_of_bytes, quietly
from cags_encoder.formats.repair import Check

RECORD = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])


@quietly
def parse_splat(data: bytes, source: str, check: Check = Splats.checked) -> Splats:
    """Splats from the bytes of a ``.splat`` file; ``source`` names it in errors. Raises :class:`SceneError`."""
    if len(data) % RECORD.itemsize:
        raise SceneError(
            f"{source}: is {len(data)} bytes long, not a multiple of 32; it is cut short or not a .splat file"
        )
    check_count(len(data) // RECORD.itemsize, source)
    rows = np.frombuffer(data, RECORD)
    splats = Splats(
        means=rows["mean"],
        quats=directed((rows["quat"].astype(np.float32) - 128.0) / np.float32(128.0)),
        log_scales=log_of_scales(rows["scale"]),
        logit_opacities=logit_of_bytes(rows["rgba"][:, 3]),
        sh0=((rows["rgba"][:, :3].astype(np.float32) / np.float32(255.0)) - np.float32(0.5)) / np.float32(SH_C0),
        sh_rest=np.zeros((len(rows), 0, 3), np.float32),
    )
    return check(splats, source)


def splat_bytes(splats: Splats) -> bytes:
    """A ``.splat`` file of ``splats`` in order. View-dependent colour is lost; colours and rotations keep 8 bits."""
    rows = np.zeros(len(splats), RECORD)
    rows["mean"] = splats.means
    rows["scale"] = np.exp(np.minimum(splats.log_scales, np.float32(88.0)))
    rgb = (0.5 + SH_C0 * splats.sh0.astype(np.float64)) * 255.0
    rows["rgba"][:, :3] = np.round(np.clip(rgb, 0.0, 255.0)).astype(np.uint8)
    rows["rgba"][:, 3] = bytes_of_logits(splats.logit_opacities)
    rows["quat"] = np.clip(np.round(splats.quats * 128.0 + 128.0), 0, 255).astype(np.uint8)
    return rows.tobytes()
