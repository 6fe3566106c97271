"""The ``cuda`` backend: parity with the reference on a device; without one, its logic on stand-ins for gsplat."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from cags_common.errors import ConfigError
from cags_common.raster import DepthKind, Footprint, RenderOptions, create
from cags_common.raster.cuda import CudaScene, why_unavailable
from cags_common.raster.harmonics import harmonics
from cags_common.splats import SH_C0, SH_REST_OF_DEGREE
from support.raster_scenes import F, assert_sound, camera, psnr_db, random_splats, tilted_camera

FOOTPRINTS = {"classic": Footprint.classic(), "antialiased": Footprint.antialiased(), "client": Footprint(0.02, 1 / 12)}


def fully_fused_projection(means, covars, quats, scales, view, pinhole, width, height, *, eps2d, **_):
    """gsplat's projection in plain torch: radii, centres, depths, conics, compensations of one view."""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=-1).unbind(-1)
    rows = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 2 * (x * y + w * z)]
    rows += [
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    ]
    axes = torch.stack(rows, -1).reshape(-1, 3, 3) * scales[:, None]
    rotation, translation = view[0, :3, :3], view[0, :3, 3]
    points = means @ rotation.T + translation
    fx, fy, cx, cy = pinhole[0, 0, 0], pinhole[0, 1, 1], pinhole[0, 0, 2], pinhole[0, 1, 2]
    depth = points[:, 2]
    tx = (points[:, 0] / depth).clamp(-0.65 * width / fx, 0.65 * width / fx)
    ty = (points[:, 1] / depth).clamp(-0.65 * height / fy, 0.65 * height / fy)
    zero = torch.zeros_like(depth)
    jacobian = torch.stack([fx / depth, zero, -fx * tx / depth, zero, fy / depth, -fy * ty / depth], -1).reshape(
        -1, 2, 3
    )
    factor = jacobian @ rotation @ axes
    plain = factor @ factor.transpose(1, 2)
    wide = plain + eps2d * torch.eye(2)
    inverse = torch.linalg.inv(wide)
    conics = torch.stack([inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1]], -1)
    compensations = (torch.linalg.det(plain) / torch.linalg.det(wide)).clamp_min(0).sqrt()
    centres = torch.stack([points[:, 0] / depth * fx + cx, points[:, 1] / depth * fy + cy], -1)
    return torch.ones(1, len(means), 2), centres[None], depth[None], conics[None], compensations[None]


def rasterize_to_pixels(centres, conics, channels, opacities, width, height, tile, offsets, order):
    """Plain front-to-back compositing; ``order`` is by depth."""
    v, u = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    image, through = torch.zeros(height, width, channels.shape[-1]), torch.ones(height, width)
    for i in order.tolist():
        dx, dy = u - centres[0, i, 0], v - centres[0, i, 1]
        a, b, c = conics[0, i]
        alpha = (opacities[0, i] * torch.exp(-0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy)).clamp_max(0.99)
        weight = through * torch.where(alpha >= 1 / 255, alpha, 0.0)
        image = image + weight[..., None] * channels[0, i]
        through = through - weight
    return image[None], (1 - through)[None, ..., None]


def spherical_harmonics(degree, directions, coefficients):
    count = SH_REST_OF_DEGREE[degree]
    unit = torch.nn.functional.normalize(directions, dim=-1).numpy().astype(np.float64)
    basis = torch.from_numpy(harmonics(unit, count).astype(F))
    return SH_C0 * coefficients[:, 0] + (basis[..., None] * coefficients[:, 1 : 1 + count]).sum(1)


STAND_INS = SimpleNamespace(
    fully_fused_projection=fully_fused_projection,
    rasterize_to_pixels=rasterize_to_pixels,
    spherical_harmonics=spherical_harmonics,
    isect_tiles=lambda centres, radii, depths, *_: (None, None, depths[0].argsort()),
    isect_offset_encode=lambda keys, images, columns, rows: torch.zeros(images, rows, columns),
)


@pytest.fixture(scope="module")
def splats():
    return random_splats(120, degree=2, seed=5)


@pytest.mark.parametrize("footprint", FOOTPRINTS.values(), ids=FOOTPRINTS)
def test_the_calls_put_together_give_the_reference(splats, footprint):
    scene, cam = CudaScene(splats, STAND_INS, "cpu"), tilted_camera(48, 32)
    options = RenderOptions(footprint=footprint, contribution=True)
    right, ours = create("reference").load(splats).render(cam, options), scene.render(cam, options)
    assert_sound(ours)
    assert psnr_db(right.rgb, ours.rgb) > 70
    np.testing.assert_allclose(ours.contribution, right.contribution, atol=2e-2)
    assert np.isclose(ours.depth, right.depth, rtol=1e-3).mean() > 0.99
    residual = np.random.default_rng(1).normal(size=(32, 48, 3)).astype(F)
    expected, found = (
        create("reference").load(splats).back_project(cam, residual, options),
        scene.back_project(cam, residual, options),
    )
    np.testing.assert_allclose(found.weighted_residual, expected.weighted_residual, atol=3e-2)
    np.testing.assert_allclose(found.weight, expected.weight, atol=2e-2)


def test_updates_and_empty_scenes(splats):
    scene, other = CudaScene(splats, STAND_INS, "cpu"), random_splats(120, degree=1, seed=6)
    scene.update(np.arange(120), other)
    cam = tilted_camera(24, 16)
    fresh = create("reference").load(other).render(cam, RenderOptions())
    assert psnr_db(scene.render(cam, RenderOptions()).rgb, fresh.rgb) > 70
    empty = CudaScene(random_splats(0), STAND_INS, "cpu")
    assert not empty.render(cam, RenderOptions(contribution=True)).rgb.any()
    assert empty.back_project(cam, np.zeros((16, 24, 3), F), RenderOptions()).weight.shape == (0,)


def test_the_median_depth_is_refused(splats):
    with pytest.raises(ConfigError, match="median is not offered"):
        CudaScene(splats, STAND_INS, "cpu").render(camera(), RenderOptions(depth=DepthKind.MEDIAN))


@pytest.mark.skipif(not why_unavailable(), reason="a CUDA device is at hand")
def test_without_a_device_it_says_why():
    with pytest.raises(ConfigError, match=r"rasteriser 'cuda' cannot run: .+; use 'cpu'"):
        create("cuda")


@pytest.mark.gpu
@pytest.mark.skipif(bool(why_unavailable()), reason=why_unavailable() or "usable")
@pytest.mark.parametrize("footprint", FOOTPRINTS.values(), ids=FOOTPRINTS)
def test_gsplat_matches_the_reference(footprint):
    splats, cam = random_splats(3000, degree=3, seed=7), tilted_camera()
    splats.logit_opacities[:] = np.minimum(splats.logit_opacities, 4)  # gsplat caps alpha at 0.999, not 0.99
    options = RenderOptions(footprint=footprint, contribution=True)
    right, ours = (create(name).load(splats).render(cam, options) for name in ("reference", "cuda"))
    assert_sound(ours)
    assert psnr_db(right.rgb, ours.rgb) > 60
    np.testing.assert_allclose(ours.contribution, right.contribution, atol=0.1, rtol=1e-2)
