"""PLY of SpaceTime Gaussians (Li et al., CVPR 2024): splats with their own motion, rotation and temporal opacity.

Besides the position, scale (logarithm), rotation and opacity (logit) of 3DGS, each vertex has ``trbf_center`` and
``trbf_scale`` (logarithm of the width; the clip lasts from 0 to 1), ``motion_0..8`` (x, y, z of the first, second and
third power of time), ``omega_0..3`` (change of the rotation) and colours ``f_dc_0..2`` that are RGB, not harmonics. The
method's lite model is read completely. Its full model also has a network that turns further features (``f_dc_3..``,
``f_t_*``) into colours; the network is not in the file, so only the base colours are read.
Layout: ``save_ply`` of https://github.com/oppo-us-research/SpacetimeGaussians
"""

from __future__ import annotations

import numpy as np

from cags_common.errors import SceneError
from cags_common.splats import SH_C0, Splats
from cags_encoder.formats.files import check_count, quietly
from cags_encoder.formats.ply import MEANS, OPACITY, QUATS, SCALES, SH0
from cags_encoder.formats.ply_container import PlyHeader, check_properties, columns, parse_header, read_rows
from cags_encoder.formats.repair import DropBroken
from cags_encoder.formats.timed import TimedSplats, checked_times

TIMES = ["trbf_center", "trbf_scale"]
MOTION = [f"motion_{i}" for i in range(9)]
OMEGA = [f"omega_{i}" for i in range(4)]
MAX_LOG_WIDTH = 80.0


def is_spacetime_ply(header: PlyHeader) -> bool:
    """Whether the vertices of a PLY file have a centre in time."""
    vertex = header.element("vertex")
    return vertex is not None and any(name == TIMES[0] for name, _ in vertex.properties)


@quietly
def parse_spacetime_ply(data: bytes, source: str, drop: DropBroken | None = None) -> TimedSplats:
    """Splats from a file's bytes, times in clip lengths; ``source`` names it in errors. Raises :class:`SceneError`."""
    header = parse_header(data, source)
    vertex = header.element("vertex")
    if vertex is None:
        raise SceneError(f"{source}: has no PLY element 'vertex'; this PLY holds no splats")
    check_count(vertex.count, source)
    check_properties(vertex, [*MEANS, *TIMES, *MOTION, *SH0, *OPACITY, *SCALES, *QUATS, *OMEGA], source)
    rows = read_rows(data, header, source)["vertex"]
    splats = Splats(
        means=columns(rows, MEANS),
        quats=columns(rows, QUATS),
        log_scales=columns(rows, SCALES),
        logit_opacities=columns(rows, OPACITY)[:, 0],
        sh0=(columns(rows, SH0) - np.float32(0.5)) / np.float32(SH_C0),
        sh_rest=np.zeros((len(rows), 0, 3), np.float32),
    )
    times = columns(rows, TIMES).astype(np.float64)
    widths = np.exp(np.clip(times[:, 1], -MAX_LOG_WIDTH, MAX_LOG_WIDTH))
    motion = columns(rows, MOTION).reshape(-1, 3, 3)
    return checked_times(TimedSplats(splats, times[:, 0], widths, motion, columns(rows, OMEGA)), source, drop)
