"""PLY of Gaussians as written by the 3DGS reference implementation (Kerbl et al. 2023), SH degrees 0 to 3.

Properties may have any order and scalar type. Normals and the properties of other methods are ignored.
Frame: that of the capture; y points down in COLMAP reconstructions.
"""

from __future__ import annotations

import numpy as np

from cags_common.errors import SceneError
from cags_common.splats import SH_REST_OF_DEGREE, Splats
from cags_encoder.formats.files import check_count, quietly
from cags_encoder.formats.ply_container import (
    PlyElement,
    check_properties,
    columns,
    header_bytes,
    parse_header,
    read_rows,
)
from cags_encoder.formats.repair import Check

MEANS = ["x", "y", "z"]
QUATS = ["rot_0", "rot_1", "rot_2", "rot_3"]  # wxyz
SCALES = ["scale_0", "scale_1", "scale_2"]  # natural logarithm
SH0 = ["f_dc_0", "f_dc_1", "f_dc_2"]
OPACITY = ["opacity"]  # logit


@quietly
def parse_ply(data: bytes, source: str, check: Check = Splats.checked) -> Splats:
    """Splats from the bytes of a PLY file; ``source`` names it in errors. Raises :class:`SceneError`."""
    header = parse_header(data, source)
    vertex = header.element("vertex")
    if vertex is None:
        raise SceneError(f"{source}: has no PLY element 'vertex'; this PLY holds no splats")
    check_count(vertex.count, source)
    rest_names = sh_rest_names(vertex, source)
    check_properties(vertex, [*MEANS, *SH0, *OPACITY, *SCALES, *QUATS], source)
    rows = read_rows(data, header, source)["vertex"]
    rest = (
        columns(rows, rest_names).reshape(len(rows), 3, -1) if rest_names else np.zeros((len(rows), 3, 0), np.float32)
    )
    splats = Splats(
        means=columns(rows, MEANS),
        quats=columns(rows, QUATS),
        log_scales=columns(rows, SCALES),
        logit_opacities=columns(rows, OPACITY)[:, 0],
        sh0=columns(rows, SH0),
        sh_rest=rest.transpose(0, 2, 1),  # the file groups coefficients by colour channel
    )
    return check(splats, source)


def sh_rest_names(element: PlyElement, source: str) -> list[str]:
    """``f_rest_0..`` in order. Raises :class:`SceneError` unless their number fits an SH degree."""
    count = sum(name.startswith("f_rest_") for name, _ in element.properties)
    if count not in {3 * k for k in SH_REST_OF_DEGREE}:
        raise SceneError(
            f"{source}: has {count} f_rest properties; 0, 9, 24 or 45 are needed for SH degree 0, 1, 2 or 3"
        )
    names = [f"f_rest_{i}" for i in range(count)]
    check_properties(element, names, source)
    return names


def ply_bytes(splats: Splats) -> bytes:
    """A PLY file of ``splats`` in their order, as the reference implementation writes it; lossless."""
    k = splats.sh_rest.shape[1]
    names = [*MEANS, "nx", "ny", "nz", *SH0, *(f"f_rest_{i}" for i in range(3 * k)), *OPACITY, *SCALES, *QUATS]
    rest = splats.sh_rest.transpose(0, 2, 1).reshape(len(splats), 3 * k)
    opacity = splats.logit_opacities[:, None]
    normals = np.zeros((len(splats), 3), np.float32)
    table = np.concatenate(
        [splats.means, normals, splats.sh0, rest, opacity, splats.log_scales, splats.quats], axis=1, dtype="<f4"
    )
    header = [f"element vertex {len(splats)}", *(f"property float {name}" for name in names)]
    return header_bytes(header) + table.tobytes()
