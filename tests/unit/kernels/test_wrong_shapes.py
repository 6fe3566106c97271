"""Arrays of wrong shapes at the kernels' own functions: refused in Python, before native code reads past them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cags_kernels import KernelError, codec, native_available
from cags_kernels.correct import AddParameters, DrawnView, add, compared, expanded
from cags_kernels.raster import NativeScene, RasterCamera, RasterOptions, enlarge

pytestmark = pytest.mark.skipif(not native_available(), reason="the native library is not built")

N = 5
OPTIONS = RasterOptions(0.3, 0.0, 0.5, 1, 0, 3, 1)
CAMERA = RasterCamera(np.eye(3), np.zeros(3), 10.0, 10.0, 8.0, 8.0, 0.1, 16, 16)


def arrays(count: int = N, coefficients: int = 3) -> list[np.ndarray]:
    shapes = ((3,), (4,), (3,), (), (3,), (coefficients, 3))
    return [np.ones((count, *shape), np.float32) for shape in shapes]


@pytest.mark.parametrize("which", range(6))
@pytest.mark.parametrize("how", ["short", "narrow", "double"])
def test_splats_of_wrong_shapes_make_no_scene_and_change_none(which: int, how: str) -> None:
    wrong = arrays()
    if how == "short":
        wrong[which] = wrong[which][:-1].copy()
    elif how == "narrow":
        wrong[which] = wrong[which][..., :-1].copy() if wrong[which].ndim > 1 else wrong[which][:, None].copy()
    else:
        wrong[which] = wrong[which].astype(np.float64)
    with pytest.raises(ValueError, match=r"shape|float32|rows"):
        NativeScene(tuple(wrong))
    scene = NativeScene(tuple(arrays()))
    with pytest.raises(ValueError, match=r"shape|float32|rows"):
        scene.update(np.arange(N), tuple(wrong))


@pytest.mark.parametrize("rows", [[0, 1, 2, 3, 5], [-1, 0, 1, 2, 3], [[0, 1, 2, 3, 4]], [0.0, 1, 2, 3, 4]])
def test_rows_that_are_not_the_splats_change_nothing(rows: list) -> None:
    scene = NativeScene(tuple(arrays()))
    with pytest.raises(ValueError, match="rows"):
        scene.update(np.array(rows), tuple(arrays()))


def test_another_number_of_coefficients_changes_nothing() -> None:
    with pytest.raises(ValueError, match="5 splats of 8 coefficients for a scene of 5"):
        NativeScene(tuple(arrays())).update(np.arange(N), tuple(arrays(coefficients=8)))


@pytest.mark.parametrize("size", [(0, 16), (16, -1), (20_000, 16)])
def test_pictures_of_impossible_sizes_are_not_drawn(size: tuple[int, int]) -> None:
    scene = NativeScene(tuple(arrays()))
    with pytest.raises(ValueError, match="sides have 1 to 16384"):
        scene.render(replace(CAMERA, width=size[0], height=size[1]), OPTIONS)
    with pytest.raises(ValueError, match="sides have 1 to 16384"):
        enlarge(np.zeros((8, 8, 3), np.float32), *size, 1)


def test_a_camera_of_another_shape_draws_nothing() -> None:
    with pytest.raises(ValueError, match="rotation"):
        NativeScene(tuple(arrays())).render(replace(CAMERA, rotation=np.eye(2)), OPTIONS)


def attribute(**changes: object) -> codec.CodecAttribute:
    table = np.zeros((4, 4), np.float32)
    return replace(codec.CodecAttribute(np.array([2], np.uint8), table, None, None, 0, "quats", 0), **changes)


@pytest.mark.parametrize(
    "changes",
    [
        {"table": np.zeros((3, 4), np.float32)},
        {"table": np.zeros((4, 4), np.float64)},
        {"table": np.zeros(16, np.float32)},
        {"layer_bits": np.array([2, 1], np.uint8)},
        {"layer_bits": np.array([2], np.int64)},
        {"column": "colours"},
        {"leaves": np.zeros((4, 4), np.float32)},
        {"leaves": np.zeros((4, 4), np.float32), "spreads": np.zeros((2, 4), np.float32), "below_bits": 2},
        {"leaves": np.zeros((4, 4), np.float32), "spreads": np.zeros((4, 4), np.float32), "below_bits": 3},
    ],
)
def test_tables_that_codes_would_reach_beyond_are_refused(changes: dict) -> None:
    assert attribute().structure()
    with pytest.raises(ValueError):
        attribute(**changes).structure()


def columns(count: int = 4) -> dict[str, np.ndarray]:
    widths = {"quats": (4,), "log_scales": (3,), "logit_opacities": (), "sh0": (3,), "sh_rest": (0, 3)}
    return {name: np.zeros((count, *shape), np.float32) for name, shape in widths.items()}


def test_codes_and_columns_that_do_not_fit_are_refused() -> None:
    whole, more = attribute().structure(), attribute(layer_bits=np.array([1], np.uint8)).structure()
    assert codec.dequantise([whole], b"\x1b", None, columns(), rodrigues=False).tolist() == [[3, 2, 1, 0]]
    assert codec.dequantise([more], b"\x0f", np.ones((1, 4), np.uint32), columns(), rodrigues=False).max() == 3
    with pytest.raises(KernelError, match="codec_dequantise: an argument is out of range"):
        codec.dequantise([more], b"\x0f", np.full((1, 4), 2, np.uint32), columns(), rodrigues=False)
    with pytest.raises(ValueError, match="codes of"):
        codec.dequantise([more], b"\x0f", np.ones((1, 3), np.uint32), columns(), rodrigues=False)
    for wrong in (np.zeros((3, 3), np.float32), np.zeros((4, 3), np.float64), np.zeros((8, 3), np.float32)[::2]):
        with pytest.raises(ValueError, match="column sh0"):
            codec.dequantise([whole], b"\x1b", None, {**columns(), "sh0": wrong}, rodrigues=False)
    with pytest.raises(ValueError, match="cells"):
        codec.positions(np.zeros((4, 2), np.float32), np.zeros(3), 0.1)
    with pytest.raises(ValueError, match="origin"):
        codec.positions(np.zeros((4, 3), np.float32), np.zeros(2), 0.1)


def test_what_is_lacking_does_not_read_arrays_of_other_shapes() -> None:
    pictures = [np.zeros((4, 5, 3), np.float32), np.zeros((4, 5), np.float32), np.ones((4, 5), np.float32)]
    parameters = AddParameters(np.eye(3, 4), (1.0, 1.0), 1, 0.1, 1.0, 0.0, 0.5, 1)
    lacking = expanded(np.zeros((3, 3, 3), np.float32), 0.1, 1)
    assert add(DrawnView(*pictures), lacking, None, parameters)[0].shape == (4, 5, 3)
    with pytest.raises(ValueError, match="shape"):
        compared(np.zeros((3, 3, 3), np.float32), np.zeros((3, 2, 3), np.float32), 0.1, 1)
    with pytest.raises(ValueError, match="shape"):
        expanded(np.zeros((3, 3, 4), np.float32), 0.1, 1)
    for which in range(2):
        wrong = [picture[:-1] if at == which else picture for at, picture in enumerate(pictures)]
        with pytest.raises(ValueError, match="shape"):
            add(DrawnView(*wrong), lacking, None, parameters)
    for wrong in (lacking[:, :, :3], lacking.astype(np.float32), lacking[0]):
        with pytest.raises(ValueError, match="int16"):
            add(DrawnView(*pictures), wrong, None, parameters)
    with pytest.raises(ValueError, match="shape"):
        add(DrawnView(*pictures), lacking, np.zeros((2, 2), np.float32), parameters)
