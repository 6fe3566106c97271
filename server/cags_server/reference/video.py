"""The numbering of one client's reference video, and when it must start anew with an IDR picture."""

from __future__ import annotations

from cags_protocol import events as ev
from cags_protocol.wire.messages import ReferenceFrame, ReferenceKind
from cags_server.reference.job import FrameRender


class ReferenceVideo:
    """Counts pictures without gaps and remembers whether the next one must stand alone."""

    def __init__(self) -> None:
        self.needs_idr = True
        """Whether the next picture must be an IDR picture; references that say nothing in between change nothing."""
        self.silent = True
        """Whether the newest reference said nothing: no earlier one is shown any more."""
        self._seq = 0
        self._idr_seq = 0

    @property
    def urgent(self) -> bool:
        """Whether the client waits for an IDR picture; not where it was last told that it lacks nothing."""
        return self.needs_idr and not self.silent

    def broken(self) -> None:
        """A picture that the encoder made will not reach the client."""
        self.needs_idr = True

    def requested(self, last_decoded: int) -> None:
        """The client asks for an IDR picture; one that is newer than what it decoded is on its way already."""
        self.needs_idr = self.needs_idr or self._idr_seq <= last_decoded

    def dropped(self, message: ReferenceFrame) -> None:
        """A reference was not delivered; a picture from before the newest IDR picture is no loss."""
        if message.kind != ReferenceKind.NOTHING:
            self.needs_idr = self.needs_idr or message.seq >= self._idr_seq

    def message(self, render: FrameRender, deadline_us: int) -> ev.Outgoing:
        """The next reference, to be sent before ``deadline_us`` (server clock)."""
        plan, coded = render.plan, render.coded
        self.silent = coded.kind is ReferenceKind.NOTHING
        if coded.kind is not ReferenceKind.NOTHING:
            self._seq += 1
        if coded.idr:
            self._idr_seq = self._seq
            self.needs_idr = False
        pose, kind = plan.predicted.pose, coded.kind.value
        message = ReferenceFrame(
            plan.frame,
            self._seq,
            pose,
            render.intrinsics,
            coded.idr,
            kind,
            plan.basis,
            coded.knee,
            coded.error,
            coded.reach,
        )
        return ev.Outgoing(message, coded.access_unit, 0, deadline_us)
