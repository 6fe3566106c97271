"""Image memory is used again only when nobody can see it any more."""

from __future__ import annotations

import gc
import subprocess
import sys

import numpy as np

from cags_kernels.buffers import BufferPool


def address(array: np.ndarray) -> int:
    return array.__array_interface__["data"][0]


def test_a_block_comes_back_when_its_last_view_is_gone():
    pool = BufferPool()
    first = pool.empty((4, 5))
    where, view = address(first), first[1:, ::2].T
    del first
    gc.collect()
    other = pool.empty((4, 5))
    assert address(other) != where  # the view still shows it
    del view
    gc.collect()
    assert address(pool.empty((2, 10))) == where


def test_torch_tensors_hold_on_to_their_block():
    import torch

    pool = BufferPool()
    array = pool.empty((8,))
    array[:] = 3
    tensor = torch.from_numpy(array)
    del array
    gc.collect()
    pool.empty((8,))[:] = 4
    assert tensor.tolist() == [3.0] * 8


def test_arrays_are_writable_contiguous_float32_of_the_shape_asked():
    array = BufferPool().empty((3, 0, 2))
    assert array.shape == (3, 0, 2)
    full = BufferPool().empty((3, 2))
    assert full.dtype == np.float32
    assert full.flags.c_contiguous
    assert full.flags.writeable


def test_few_blocks_wait():
    pool = BufferPool()
    arrays = [pool.empty((100,)) for _ in range(40)]
    del arrays
    gc.collect()
    assert len(pool._waiting) <= 12


def test_arrays_that_live_to_the_end_of_the_program_end_it_quietly():
    code = "import sys; from cags_kernels.buffers import BufferPool; sys.kept = kept = BufferPool().empty((9,))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stderr == ""


def test_blocks_begin_where_a_cache_line_does():
    pool = BufferPool()
    held = [pool.empty(shape) for shape in ((1,), (3, 5), (300, 400, 3), (1200, 1600))]
    assert all(address(array) % 64 == 0 for array in held)
