"""Where presented frames go: numbered PNG files, an MP4, stage pictures, a scoring spool, or several of these."""

from __future__ import annotations

from cags_client.present.base import FrameSink, FrameStats
from cags_client.present.files import Mp4Sink, PngSink, StagesSink, open_save
from cags_client.present.spool import ScoringSpool

__all__ = ["FrameSink", "FrameStats", "Mp4Sink", "PngSink", "ScoringSpool", "StagesSink", "open_save"]
