"""Small sequences as the methods of the field write them, one of each kind that the encoder must take."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cags_encoder.formats import write_splats
from support.codec_scenes import cloud, with_changes


def per_frame_ply(folder: Path, frames: int = 5, n: int = 300) -> Path:
    """TrackerSplat, 4DGS exports: numbered PLY files, rows keep their splat, some of which move."""
    first = cloud(n, 1)
    for k in range(frames):
        means = first.means.copy()
        means[: n // 4, 1] += np.float32(0.02 * k)
        write_splats(_made(folder) / f"time_{k:05d}.ply", with_changes(first, means=means))
    return folder


def training_folders(folder: Path, frames: int = 4, n: int = 300) -> Path:
    """HiCoM, 3DGStream: a training folder a frame, later ones with splats appended."""
    whole = cloud(n + 40 * frames, 2)
    for k in range(frames):
        out = folder / f"frame{k + 1}" / "point_cloud" / "iteration_150"
        means = whole.means.copy()
        means[:50] += np.float32(0.01 * k)
        part = with_changes(whole, means=means).take(np.arange(n + 40 * k))
        write_splats(_made(out) / "point_cloud.ply", part)
    return folder


def params_npz(folder: Path, frames: int = 4, n: int = 250) -> Path:
    """Dynamic 3D Gaussians: one archive of arrays over time."""
    rng, base = np.random.default_rng(3), cloud(n, 3)
    drift = rng.normal(size=(frames, n, 3)).cumsum(axis=0) * 0.01
    path = _made(folder) / "params.npz"
    np.savez(
        path,
        means3D=(base.means + drift * (np.arange(n) < n // 3)[:, None]).astype(np.float32),
        rgb_colors=np.broadcast_to(rng.uniform(size=(n, 3)), (frames, n, 3)).astype(np.float32),
        unnorm_rotations=np.broadcast_to(base.quats, (frames, n, 4)).astype(np.float32),
        log_scales=base.log_scales,
        logit_opacities=base.logit_opacities[:, None],
    )
    return path


def shuffled_ply(folder: Path, frames: int = 4, n: int = 300) -> Path:
    """A new order and a new count in every frame."""
    rng, whole = np.random.default_rng(4), cloud(n + 60, 4)
    for k in range(frames):
        rows = rng.permutation(n + 60)[: n + 15 * k]
        write_splats(_made(folder) / f"{k:03d}.ply", whole.take(rows))
    return folder


def cut_ply(folder: Path, frames: int = 4, n: int = 300) -> Path:
    """A cut to another scene half way: nothing connects, and a key frame must begin."""
    one, other = cloud(n, 5), cloud(n + 20, 6)
    other = with_changes(other, means=other.means + np.float32(500))
    for k in range(frames):
        scene = one if k < frames // 2 else other
        order = np.random.default_rng(k).permutation(len(scene))
        write_splats(_made(folder) / f"{k:03d}.ply", scene.take(order))
    return folder


KINDS = {
    "per-frame PLY": per_frame_ply,
    "training folders": training_folders,
    "params.npz": params_npz,
    "shuffled PLY": shuffled_ply,
    "cut": cut_ply,
}


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder
