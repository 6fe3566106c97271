"""Whatever bytes come, a parser gives checked splats or one line of SceneError, in bounded memory.

2,000 damaged files a parser in the usual run, 100,000 with ``-m nightly``.
"""

import tracemalloc
import warnings
import zlib
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cags_common.errors import SceneError
from cags_encoder.formats import FORMATS
from cags_encoder.formats.spz import parse_spz
from support.mutation import mutate
from support.splat_files import (
    gzipped,
    random_splats,
    spz4_bytes,
    spz_parts,
    spz_streams,
    with_meta,
    zip_files,
    zip_of,
)

COUNT = 40
PARSERS = {**{name: entry.parse for name, entry in FORMATS.items()}, "spz-4": parse_spz}
WRITERS = {**{name: entry.write for name, entry in FORMATS.items()}, "spz-4": spz4_bytes}
BASE_BYTES, FACTOR = 4 << 20, 400
"""What a parser may allocate at its peak: a base, and a factor of the bytes that it was given (gzip: 1000:1)."""


@cache
def originals(name: str) -> tuple[bytes, ...]:
    return tuple(WRITERS[name](random_splats(COUNT, degree, degree)) for degree in (0, 1, 3))


def damaged_inside(name: str, data: bytes, rng: np.random.Generator) -> bytes:
    """Damage that leaves the outer container whole: else checksums would catch nearly all of it."""
    if name == "spz":
        return gzipped(mutate(zlib.decompress(data, 31), rng))
    if name == "spz-4":
        header, parts = spz_parts(random_splats(COUNT, 1, 1))
        victim = str(rng.choice(sorted(parts)))
        return spz_streams(header, {**parts, victim: mutate(parts[victim], rng)})
    if name == "sog":
        files = zip_files(data)
        victim = str(rng.choice(sorted(files)))
        return zip_of({**files, victim: mutate(files[victim], rng)})
    return mutate(data, rng)


def parse_or_refuse(name: str, data: bytes) -> bool:
    """Whether the file was read; any exception but a one-line SceneError fails the test."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            splats = PARSERS[name](data, "f")
        except SceneError as error:
            assert "\n" not in str(error)
            assert str(error).startswith("f: ")
            return False
    assert len(splats) > 0
    for array_name, array in splats.arrays():
        assert array.dtype == np.float32, array_name
        assert np.isfinite(array).all(), array_name
    return True


def fuzz(name: str, cases: int, seed: int) -> int:
    """Parse ``cases`` damaged files; how many were still readable."""
    read = 0
    for case in range(cases):
        rng = np.random.default_rng((seed, case))
        data = originals(name)[case % 3]
        damage: Callable[[bytes], bytes] = (
            (lambda d: mutate(d, rng)) if case % 2 else (lambda d: damaged_inside(name, d, rng))  # noqa: B023
        )
        read += parse_or_refuse(name, damage(data))
    return read


@pytest.mark.parametrize("name", PARSERS)
def test_damaged_files(name: str) -> None:
    read = fuzz(name, 2_000, seed=1)
    assert 0 < read < 2_000  # the damage is neither all fatal nor all harmless


@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", PARSERS)
def test_damaged_files_at_length(name: str) -> None:
    fuzz(name, 100_000, seed=2)


@pytest.mark.parametrize("name", PARSERS)
def test_memory_stays_within_its_bound(name: str) -> None:
    parse_or_refuse(name, originals(name)[2])  # imports and caches
    tracemalloc.start()
    try:
        for case in range(150):
            rng = np.random.default_rng((3, case))
            data = damaged_inside(name, originals(name)[case % 3], rng)
            tracemalloc.reset_peak()
            before = tracemalloc.get_traced_memory()[0]
            parse_or_refuse(name, data)
            peak = tracemalloc.get_traced_memory()[1] - before
            assert peak <= BASE_BYTES + FACTOR * len(data), f"case {case}: {peak} bytes for {len(data)}"
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("name", PARSERS)
@settings(max_examples=150)
@given(data=st.binary(max_size=400))
def test_noise(name: str, data: bytes) -> None:
    parse_or_refuse(name, data)


LINES = st.sampled_from(
    [
        "element vertex 3", "element chunk 1", "element sh 3", "element vertex 99999999999", "property float x",
        "property double y", "property float z", "property uint packed_position", "property list uchar int a",
        "comment hi", "format ascii 1.0", "property", "element", "", "property float f_rest_0", "element vertex 0",
    ]
)  # fmt: skip


@pytest.mark.parametrize("name", ["ply", "compressed-ply"])
@settings(max_examples=200)
@given(lines=st.lists(LINES, max_size=12), body=st.binary(max_size=64))
def test_ply_headers_of_any_lines(name: str, lines: list[str], body: bytes) -> None:
    header = "\n".join(["ply", "format binary_little_endian 1.0", *lines, "end_header", ""])
    parse_or_refuse(name, header.encode() + body)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=4),
    max_leaves=12,
)
FIELDS = st.sampled_from(
    ["version", "count", "means", "means.mins", "means.maxs", "means.files", "scales.codebook", "quats.files", "sh0",
     "sh0.codebook", "shN", "shN.bands", "shN.count", "shN.codebook", "shN.files"]
)  # fmt: skip


@settings(max_examples=200)
@given(field=FIELDS, value=JSON)
def test_sog_meta_of_any_json(field: str, value: object) -> None:
    parse_or_refuse("sog", with_meta(originals("sog")[1], **{field: value}))
