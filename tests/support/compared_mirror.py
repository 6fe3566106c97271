"""What the server drew for each reference, beside what the client holds when it shows that reference."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from cags_client.frame.pipeline import ClientPipeline
from cags_client.frame.presented import PresentedFrame
from cags_common.correction.views import StagedViews
from cags_common.raster.base import RenderedView, RenderOptions
from cags_common.splats import Splats
from cags_common.tiles.inventory import InventoryEntry
from cags_server.reference.job import FrameJob
from support.closed_loop import assert_same, copied


class Compared:
    """Notes what the mirror held for each reference, and compares it with what the client holds that shows it."""

    def __init__(self, patch: pytest.MonkeyPatch, *, always: bool = True) -> None:
        """``always``: the server draws the mirror for every reference, as for differences alone."""
        self._always = always
        self.frames: list[int] = []
        self._made: dict[tuple[int, int], Splats] = {}
        """By frame and mark of the newest connection."""
        self._newest = 0
        """Order of the newest reference that was in force. After a change of speed an older one, of a later frame, may
        follow it: the client then shows more than that one assumes.
        """
        staged, present, restarted = FrameJob._staged, ClientPipeline.present, ClientPipeline.restarted

        def noted(job: FrameJob, drawn: RenderedView, options: RenderOptions) -> StagedViews:
            views = staged(job, drawn, options)
            if views.compared:
                assert job.mirror is not None
                assert job.mirror.splats is not None
                self._made[job.plan.frame, job.plan.basis] = copied(job.mirror.splats)
            return views

        def compared(pipeline: ClientPipeline, frame: int, *arguments: Any, **named: Any) -> PresentedFrame:
            before = pipeline._used
            shown = present(pipeline, frame, *arguments, **named)
            reference = shown.reference
            if reference is None or not reference.assumes:
                return shown
            if reference.frame == frame and pipeline._used > before and reference.order >= self._newest:
                basis = reference.basis - pipeline._marked_before
                if basis > 0:  # of this connection
                    self._compare(pipeline, frame, basis)
            self._newest = max(self._newest, reference.order)
            return shown

        def taken_up(pipeline: ClientPipeline, inventory: Sequence[InventoryEntry]) -> None:
            self._made.clear()
            restarted(pipeline, inventory)

        patch.setattr(FrameJob, "_staged", noted)
        patch.setattr(ClientPipeline, "present", compared)
        patch.setattr(ClientPipeline, "restarted", taken_up)

    def _compare(self, pipeline: ClientPipeline, frame: int, basis: int) -> None:
        store, made = pipeline.on_display, self._made.get((frame, basis))
        if made is None:
            assert not self._always or store is None or not store.begun, "the client holds what the mirror lacks"
            return
        assert store is not None
        assert_same(store.splats, made, f"frame {frame}, mark {basis}")
        self.frames.append(frame)
