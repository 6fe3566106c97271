"""The interface with the native library: structures are compared with its own, and lengths are checked on its side."""

from __future__ import annotations

import ctypes
from collections.abc import Callable

import numpy as np
import pytest

from cags_kernels import KernelError, codec, correct, library, motion, native_available, raster

pytestmark = pytest.mark.skipif(not native_available(), reason="the native library is not built")

INVALID = 1
STRUCTURES = {
    "CagsSplats": raster._Splats,
    "CagsCamera": raster._Camera,
    "CagsRasterOptions": raster._Options,
    "CagsRasterTargets": raster._Targets,
    "CagsRasterStatistics": raster._Statistics,
    "CagsLackInput": correct._LackInput,
    "CagsAddInput": correct._AddInput,
    "CagsCodecAttribute": codec._Attribute,
    "CagsCodecTile": codec._Tile,
    "CagsCodecTargets": codec._Targets,
    "CagsCodecSymbols": codec._Symbols,
    "CagsMotionTree": motion._Tree,
    "CagsMotionTile": motion._Tile,
    "CagsMotionArrays": motion._Arrays,
    "CagsSymbolsEncoding": motion._SymbolsEncoding,
    "CagsTreeEncoding": motion._TreeEncoding,
}
OF_ARRAYS = {"CagsKnot"}
"""Structures that are rows of an array here: nine integers."""


def test_every_structure_of_the_library_has_one_here_and_they_are_the_same() -> None:
    layout = library._layout(library.library())
    assert set(layout) == set(STRUCTURES) | OF_ARRAYS
    assert {name: library.difference(made, layout[name]) for name, made in STRUCTURES.items()} == dict.fromkeys(
        STRUCTURES, ""
    )
    assert layout["CagsKnot"][""] == (0, 9 * ctypes.sizeof(ctypes.c_int32))


def structure(*fields: tuple[str, type]) -> type[ctypes.Structure]:
    return type("_Made", (ctypes.Structure,), {"_fields_": list(fields)})


CAPACITY = ("capacity", ctypes.c_int64)
ARRAYS = [(name, ctypes.c_void_p) for name in ("means", "quats", "logits", "into_means", "into_quats", "into_logits")]
LENGTHS = ("lengths", ctypes.c_int64 * 6)


@pytest.mark.parametrize(
    ("fields", "what"),
    [
        ([CAPACITY, *ARRAYS[:-1], LENGTHS], "the whole"),
        ([("capacity", ctypes.c_int32), *ARRAYS, LENGTHS], "capacity"),
        ([*ARRAYS, CAPACITY, LENGTHS], "means"),
        ([CAPACITY, *ARRAYS[:-1], ("else", ctypes.c_void_p), LENGTHS], "else"),
    ],
)
def test_another_size_type_order_or_name_is_refused_by_name(fields: list, what: str) -> None:
    with pytest.raises(KernelError, match=f"CagsMotionArrays is another than the library's: {what} at"):
        library.native("CagsMotionArrays")(structure(*fields))


def test_a_structure_that_the_library_lacks_is_refused() -> None:
    with pytest.raises(KernelError, match="CagsNothing"):
        library.native("CagsNothing")(structure(("count", ctypes.c_int64)))


def arrays(count: int = 4) -> tuple[np.ndarray, ...]:
    shapes = ((3,), (4,), (3,), (), (3,), (3, 3))
    return tuple(np.ones((count, *shape), np.float32) for shape in shapes)


@pytest.mark.parametrize("which", range(6))
def test_the_library_refuses_splats_whose_lengths_do_not_fit(which: int) -> None:
    held = arrays()
    given = raster._splats(held)
    given.lengths[which] -= 1
    handle = ctypes.c_void_p()
    create = library.library().cags_raster_scene_create
    assert create(ctypes.byref(given), 1, ctypes.byref(handle)) == INVALID
    assert not handle


OPTIONS = raster.RasterOptions(0.3, 0.0, 0.5, 1, 1, 3, 1)
CAMERA = raster.RasterCamera(np.eye(3), np.zeros(3), 10.0, 10.0, 8.0, 8.0, 0.1, 16, 16)


@pytest.mark.parametrize("which", range(4))
@pytest.mark.parametrize("change", [-1, 1])
def test_the_library_refuses_targets_of_another_size(which: int, change: int) -> None:
    scene = raster.NativeScene(arrays())
    held = [np.full(shape, 7, np.float32) for shape in ((16, 16, 3), (16, 16), (16, 16), (4,))]
    targets = raster._targets(*held)
    targets.lengths[which] += change
    arguments = raster._arguments(CAMERA, OPTIONS)
    render = library.library().cags_raster_render
    assert render(scene._handle, *arguments, ctypes.byref(targets), None) == INVALID
    assert all((array == 7).all() for array in held), "nothing is written"


@pytest.mark.parametrize("call", ["cags_raster_scene_update", "cags_raster_scene_move"])
@pytest.mark.parametrize(("splats", "count", "threads"), [(2, 2, 1), (4, 5, 1), (4, -1, 1), (4, 2, 0)])
def test_the_library_refuses_changes_that_do_not_fit_the_scene(
    call: str, splats: int, count: int, threads: int
) -> None:
    scene, held, rows = raster.NativeScene(arrays()), arrays(splats), np.arange(5)
    given, numbers = raster._splats(held), (ctypes.c_void_p(rows.ctypes.data), ctypes.c_int64(count))
    assert getattr(library.library(), call)(scene._handle, *numbers, ctypes.byref(given), threads) == INVALID


@pytest.mark.parametrize("change", [(-1, 0), (0, -1), (3, 0)])
def test_the_library_enlarges_no_picture_of_another_size(change: tuple[int, int]) -> None:
    half, whole = np.zeros((4, 4, 3), np.float32), np.zeros((8, 8, 3), np.float32)
    sizes = ctypes.c_int64(half.size + change[0]), *(ctypes.c_int32(n) for n in (8, 8, 1))
    out = ctypes.c_void_p(whole.ctypes.data), ctypes.c_int64(whole.size + change[1])
    assert library.library().cags_enlarge(ctypes.c_void_p(half.ctypes.data), *sizes, *out) == INVALID


def caught(monkeypatch: pytest.MonkeyPatch, name: str, alter: Callable[[ctypes.Structure], None]) -> None:
    """Let ``alter`` change the structure that the next calls of ``name`` are given."""
    loaded = library.library()
    true = getattr(loaded, name)

    class Altering:
        def __getattr__(self, other: str) -> object:
            return getattr(loaded, other)

    def call(given: object, *rest: object) -> int:
        alter(given._obj)  # type: ignore[attr-defined]
        return int(true(given, *rest))

    altering = Altering()
    setattr(altering, name, call)
    monkeypatch.setattr(correct, "library", lambda: altering)


PARAMETERS = correct.AddParameters(np.eye(3, 4), (1.0, 1.0), 1, 0.1, 1.0, 0.0, 0.5, 1)
VIEW = correct.DrawnView(*(np.zeros(shape, np.float32) for shape in ((4, 5, 3), (4, 5), (4, 5))))


@pytest.mark.parametrize("field", ["rgb_length", "alpha_length", "depth_length", "lack_length", "veto_length"])
def test_the_library_refuses_a_view_whose_lengths_do_not_fit(monkeypatch: pytest.MonkeyPatch, field: str) -> None:
    lacking = correct.expanded(np.zeros((3, 3, 3), np.float32), 0.1, 1)
    veto = np.zeros((4, 5), np.float32)
    assert correct.add(VIEW, lacking, veto, PARAMETERS)[0].shape == (4, 5, 3)
    caught(monkeypatch, "cags_add_lack", lambda given: setattr(given, field, getattr(given, field) - 1))
    with pytest.raises(KernelError, match="an argument is out of range"):
        correct.add(VIEW, lacking, veto, PARAMETERS)


@pytest.mark.parametrize("field", ["coded_length", "own_length"])
def test_the_library_refuses_a_reference_whose_lengths_do_not_fit(monkeypatch: pytest.MonkeyPatch, field: str) -> None:
    caught(monkeypatch, "cags_lack", lambda given: setattr(given, field, getattr(given, field) - 3))
    with pytest.raises(KernelError, match="an argument is out of range"):
        correct.expanded(np.zeros((3, 3, 3), np.float32), 0.1, 1)
    with pytest.raises(KernelError, match="an argument is out of range"):
        correct.compared(np.zeros((3, 3, 3), np.float32), np.zeros((3, 3, 3), np.float32), 0.1, 1)
