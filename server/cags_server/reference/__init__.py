"""References: what a client lacks of a frame, or a picture of it, made ahead for a predicted pose."""

from cags_server.reference.job import FrameJob, FramePlan, FrameRender

__all__ = ["FrameJob", "FramePlan", "FrameRender"]
