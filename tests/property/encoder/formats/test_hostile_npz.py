"""Damaged ``params.npz`` archives give a scene or one line of SceneError. 2,000 cases, 100,000 with ``-m nightly``."""

import io
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest

from cags_common.errors import SceneError
from cags_encoder.scenes.dynamic3d import Dynamic3dScene
from cags_encoder.scenes.file_options import FileOptions
from support.mutation import mutate
from support.splat_files import zip_files


def original(compressed: bool) -> bytes:
    rng = np.random.default_rng(0)
    out = io.BytesIO()
    save = np.savez_compressed if compressed else np.savez
    save(
        out,
        means3D=rng.normal(size=(2, 8, 3)).astype(np.float32),
        rgb_colors=rng.uniform(size=(2, 8, 3)).astype(np.float32),
        unnorm_rotations=rng.normal(size=(2, 8, 4)).astype(np.float32),
        log_scales=rng.normal(size=(8, 3)).astype(np.float32),
        logit_opacities=rng.normal(size=(8, 1)).astype(np.float32),
    )
    return out.getvalue()


def rezipped(files: dict[str, bytes], compressed: bool) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return out.getvalue()


def read_or_refuse(path: Path) -> bool:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            scene = Dynamic3dScene(path, FileOptions())
            scene.frame(len(scene) - 1)
        except SceneError as error:
            assert "\n" not in str(error)
            assert str(error).startswith(str(path))
            return False
    return True


def fuzz(folder: Path, cases: int, seed: int) -> int:
    path, read = folder / "params.npz", 0
    for case in range(cases):
        rng = np.random.default_rng((seed, case))
        compressed = bool(case % 2)
        data = original(compressed)
        if case % 4 < 2:
            files = zip_files(data)
            victim = str(rng.choice(sorted(files)))
            data = rezipped({**files, victim: mutate(files[victim], rng)}, compressed)
        else:
            data = mutate(data, rng)
        path.unlink(missing_ok=True)  # a mapped file must not change under its mapping
        path.write_bytes(data)
        read += read_or_refuse(path)
    return read


def test_damaged_archives(tmp_path: Path) -> None:
    assert 0 < fuzz(tmp_path, 2_000, seed=1) < 2_000


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_damaged_archives_at_length(tmp_path: Path) -> None:
    fuzz(tmp_path, 100_000, seed=2)
