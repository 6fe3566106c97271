"""Whatever is sent and however it is read: at every reference the server's mirror holds what its client shows."""

from __future__ import annotations

import tempfile
import uuid
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cags_common.bundle import BundleReader
from support.closed_loop import Session, encoded_clip, served
from support.examples import examples
from support.moving_bundle import write_moving
from support.small_motion import moving, random_frames, written
from support.small_store import manifest

STEPS = 150


def small(seed: int) -> BundleReader:
    """Looks that take splats from each other, updates and motion: two groups of frames, of few splats."""
    rng = np.random.default_rng(seed)
    of = moving(manifest(frames=9, starts=(0, 5)))
    with tempfile.TemporaryDirectory() as folder:
        clip = written(Path(folder), of, random_frames(rng, of))
        for frame in range(of.frames):
            clip.reader.removed_payload(frame)  # read while the folder is there
        return clip.reader


def drawn(seed: int) -> BundleReader:
    """Splats that come and go, with motion or without."""
    return write_moving(f"memory://{uuid.uuid4().hex}", seed, motion=bool(seed % 2))


BUNDLES: dict[str, Callable[[int], BundleReader]] = {
    "small": small,
    "drawn": drawn,
    "video": lambda seed: encoded_clip("video"),
    "density": lambda seed: encoded_clip("density"),
}


@pytest.mark.parametrize("kind", sorted(BUNDLES))
@settings(max_examples=examples(15), deadline=None)
@given(seed=st.integers(0, 2**32), few=st.booleans(), whole=st.booleans())
@example(seed=138567, few=True, whole=False)  # a level comes again between a jump back and its replay
@example(seed=65011, few=False, whole=True)  # opacities are updated of what ends with the first frame of its motion
def test_at_every_reference_the_mirror_holds_what_the_client_shows(
    kind: str, seed: int, few: bool, whole: bool
) -> None:
    rng = np.random.default_rng(seed)
    library = served(BUNDLES[kind](seed), decoded_bytes=20_000 if seed % 3 else 1 << 30)
    with pytest.MonkeyPatch.context() as patch:
        if not whole:  # groups are dropped when they are past
            patch.setattr("cags_common.bundle.manifest.MAX_WHOLE_SPLATS", 0)
        if few:  # layers that wait for their base, or their looks, are given up
            patch.setattr("cags_common.store.reorder_buffer.MAX_WAITING_BYTES", 60)
        sessions = [Session(library, rng) for _ in range(1 + seed % 3)]
        for _ in range(STEPS):
            sessions[rng.integers(len(sessions))].step()
        for session in sessions:
            session.finish()
