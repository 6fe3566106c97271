"""What a reference says, and its video: the difference that a client lacks, or a picture, whichever leaves less.

A *difference* is the true view minus that of the client's splats. It wins where these are good. Where they are poor and
change in every frame, their own flicker would be coded, and a *picture* of the scene, which is steady in time, predicts
better; and where splats stand in the wrong place, a picture makes them give way to it. Both are known here, so both are
tried: the kind in use in every reference, the other one from time to time, beside it, by what they leave at the
display's size (:mod:`.detail`) and by their bytes. A change of kind begins a new video, which costs a picture that
needs no other.

Where the renderer has too much to do (:mod:`.render_slots`), references are coded *lightly*: by an encoder that takes
half the time and more bytes, without trials of the other kind, and without a look at what a difference leaves. That is
half of the time that coding takes.

Only the part of a difference that remains valid while the viewer turns is sent (:mod:`.lasting`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from cags_common.correction import ComparedViews, Look, StagedViews
from cags_common.correction.compander import ZERO, compand_by_table, expand
from cags_common.correction.reach import HOLDS
from cags_common.geometry import F32, Camera, Intrinsics
from cags_common.poses import Focus
from cags_common.video.colour import Chroma, rgb_of_ycbcr, ycbcr_of_rgb
from cags_common.video.h264 import H264Decoder, H264Encoder, is_idr
from cags_protocol.wire.messages import ANY_REFERENCE, HALF_CHROMA, NO_REFERENCES, Hello, ReferenceKind
from cags_server.reference.detail import by_block, detail_left
from cags_server.reference.lasting import SOMEWHERE, Blocks, Lasting
from cags_server.reference.lateness import Lateness
from cags_server.settings import ServerSettings

DIFFERENCE, PICTURE, NOTHING = ReferenceKind.DIFFERENCE, ReferenceKind.PICTURE, ReferenceKind.NOTHING

LOOKS = {DIFFERENCE: frozenset({Look.LACK, Look.COMPANDED}), PICTURE: frozenset({Look.TRUTH, Look.LACK})}
"""What a reference of a kind is made from."""

INVISIBLE = (0.5 / 255) ** 2
"""Mean squared difference, over blocks that differ at all, up to which nothing is sent: half a step of 8 bits."""

NO_DIFFERENCE = (0.02 / 255) ** 2
"""Largest mean squared difference of a block that counts as none: rounding, or nothing is drawn there."""

QUIET = (0.8 / 255) ** 2
"""Mean squared difference of a block that is left out: coding it would bring as much noise as it takes away."""

LEAST_SIDE_PX = 16
"""Of a reference, however small the display."""

LOOKED_AT = 2
"""Every how many rows and columns of a decoded reference are looked at to see what it leaves."""

KNEES = (0.03, 0.06, 0.12, 0.24)
"""Of the compander; a new one breaks the prediction from picture to picture, so there are few."""

KNEE_OF_RMS = 2.5
"""Knee for differences of a given root mean square: measured on six scenes, 0.05 at middle levels, 0.15 at the base."""

KEEP_KNEE = 1.8
"""A knee in use stays while it is within this factor of the best."""

TRIAL_EVERY, TRIAL_LENGTH = 20, 4
"""References from one trial of the other kind to the next, and in it. Its first picture, which needs no other, does not
count.
"""

GROWN = 2.0
"""Where the score of the kind in use has grown by this factor since the last trial, the next begins at once: a client
may lose track of what moves within ten frames.
"""

BETTER = 0.8
"""The other kind takes over where its score is less than this share of that in use."""

RATE_EXPONENT = 0.5
"""Error times bytes to this power is the score of a kind: twice the bytes must bring 1.5 dB."""

LEAST_CRF_STEP, WORST_CRF = 2.0, 41.0

CRF_OF_DOUBLE = 6.0
"""By how much more crf a picture takes half the bytes."""

RATE_WINDOW, FIRST_WINDOW = 24, 6
"""References over which the video's rate is looked at before its quality changes: so many; where it is far off, after
fewer.
"""

ABOVE, FAR_ABOVE, BELOW, FAR_BELOW = 1.25, 1.8, 0.5, 0.3
"""Rates, shares of what is asked for, beyond which quality changes."""

MOST_SHARE = 2.5
"""A picture may take so many times what pictures are to take on average. Where it takes more, it is coded again as one
that needs no other, of a quality chosen for that: on a thin link two or three such pictures block everything else.
"""

RATE_STEP, BUFFER_S, LEAST_BPS = 1.25, 0.1, 50_000
"""Of a video of constant rate: begun anew when off by more than the factor; kept over so many seconds; at least."""


@dataclass(frozen=True, eq=False)
class Coded:
    """A reference on the wire."""

    kind: ReferenceKind
    access_unit: bytes = b""
    knee: float = KNEES[-1]
    idr: bool = False
    before: float = 0.0
    """Mean squared error of the client's render from the reference camera, [0, 1] RGB."""
    after: float | None = 0.0
    """Mean squared error of coding, RGB in [0, 1]; None if it was not measured."""
    reach: float = HOLDS
    """How far from its camera a difference holds, radians."""

    @property
    def error(self) -> float:
        """What the client is told: of a picture what coding has left."""
        return min(self.after or 0.0, 1.0) if self.kind is PICTURE else 0.0


class _Video:
    """One stream of pictures and what its decoder makes of them."""

    def __init__(self, encoder: H264Encoder) -> None:
        self._encoder, self._decoder = encoder, H264Decoder()

    def unit(self, picture: F32, *, idr: bool) -> bytes:
        """The access unit of ``picture`` [h, w, 3] in [0, 1]. Either each is looked at (:meth:`coded`), or none."""
        return self._encoder.encode_ycbcr(ycbcr_of_rgb(picture), idr=idr)

    def coded(self, picture: F32, *, idr: bool) -> tuple[bytes, F32]:
        """As :meth:`unit`, and the picture that the client will decode."""
        unit = self.unit(picture, idr=idr)
        decoded = self._decoder.decode_ycbcr(unit)
        assert decoded is not None, "an encoder's first picture is an IDR picture"
        return unit, rgb_of_ycbcr(decoded)


class ReferenceCoder:
    """The references of one client. Not thread-safe: a client's references are coded one after the other."""

    def __init__(self, settings: ServerSettings, hello: Hello, fps: float, focus: Focus = SOMEWHERE) -> None:
        """``hello`` says what the client can use: its kinds of references, its video decoder, its display's size;
        ``focus`` where the scene is.
        """
        self._settings, self._fps = settings, fps
        client: Intrinsics = hello.intrinsics
        width, height = (max(LEAST_SIDE_PX, side // 2 * 2) for side in (client.width_px, client.height_px))
        full = settings.reference_full_size
        self.width_px = width if full else min(settings.reference_width, width)
        self.height_px = height if full else min(settings.reference_height, height)
        self.kinds = _kinds(settings, hello)
        """What may be sent, the one to begin with first; none: no references at all."""
        half = hello.chroma == HALF_CHROMA
        self._chroma = Chroma.HALF if half else Chroma(settings.reference_chroma)
        self._bps = settings.reference_kbps * 1000 if settings.reference_kbps else None
        self._crf = settings.reference_crf
        self._videos: dict[ReferenceKind, _Video] = {}
        self._trial = _Trial(first=TRIAL_LENGTH)
        self._knee = KNEES[-1]
        self._begin_anew = True
        self._light = False
        self._mean_bytes, self._counted = 0.0, 0
        self.lateness = Lateness()
        """Whether references come in time."""
        self._lasting = Lasting(focus)
        self._share: F32 | None = None  # of the current difference that is sent
        self._picture_left = 0.0  # error of the newest picture that was coded
        self._target_bytes = 0.0  # of a picture that needs others; 0: not known

    @property
    def may_compare(self) -> bool:
        """Whether the mirror's render may be needed, now or later: the mirror has to know all that is sent."""
        return DIFFERENCE in self.kinds

    @property
    def compares(self) -> bool:
        """Whether the mirror's render is needed now: not of a client whose references often come late."""
        return self.may_compare and not (PICTURE in self.kinds and self.lateness.often)

    @property
    def kind(self) -> ReferenceKind | None:
        """The kind in use; None: no references at all."""
        return self.kinds[0] if self.kinds else None

    def follow(self, link_bps: float, period_us: float) -> None:
        """The link carries ``link_bps`` now, and a reference goes every ``period_us``: quality follows."""
        target_bps = link_bps * self._settings.reference_share
        if self._settings.reference_full_size:
            self._follow_at_constant_rate(max(int(target_bps), LEAST_BPS))
            return
        self._target_bytes = target_bps * period_us / 8e6
        share = self._mean_bytes / self._target_bytes
        far = self._counted >= FIRST_WINDOW and not FAR_BELOW <= share <= FAR_ABOVE
        if far or (self._counted >= RATE_WINDOW and not BELOW <= share <= ABOVE):
            self._set_crf(self._crf + CRF_OF_DOUBLE * np.log2(share))

    def _set_crf(self, crf: float) -> bool:
        """Begin new videos of this quality, or the nearest that there may be; False where it is much the same."""
        wanted = float(np.clip(crf, self._settings.reference_crf, WORST_CRF))
        if abs(wanted - self._crf) < LEAST_CRF_STEP:
            return False
        self._recode(wanted)
        return True

    @property
    def looks(self) -> frozenset[Look]:
        """What the next reference will be made from for certain."""
        return LOOKS[self.kinds[0]] if self.kinds else frozenset()

    @property
    def knee(self) -> float:
        """Knee of the compander in the last difference, and most likely in the next."""
        return self._knee

    def code(self, truth: F32, mirror: F32 | None, *, idr: bool, octaves: float = 0.0, light: bool = False) -> Coded:
        """The reference of the scene, ``truth`` [h, w, 3], for a client that sees ``mirror`` [h, w, 3] from there.

        Both are RGB of the display's range; None: the client holds nothing, or is not compared with. ``idr``: the
        reference must need no other. ``octaves``: by how many the client's display shows more than the reference has.
        ``light``: spare the processor.
        """
        return self.code_views(StagedViews(truth, mirror), idr=idr, octaves=octaves, light=light)

    def code_views(
        self,
        views: ComparedViews,
        *,
        idr: bool,
        octaves: float = 0.0,
        light: bool = False,
        camera: Camera | None = None,
        appeared: Blocks | None = None,
    ) -> Coded:
        """As :meth:`code`. If views have depth and ``camera`` is given, only the valid part of a difference is sent;
        ``appeared`` as in :meth:`Lasting.share`.
        """
        if not self.kinds:
            return Coded(NOTHING)
        if light is not self._light:
            self._light = light
            self._recode(self._crf)
        if self.lateness.often and self.kinds[0] is DIFFERENCE and PICTURE in self.kinds:
            self._change_kind()
        before, self._share, reach = _power(views.lack), None, HOLDS
        if self.compares:
            if before <= INVISIBLE * _differing_share(views.lack):
                return Coded(NOTHING, before=before, after=before)
            if self.kinds[0] is PICTURE and before < self._picture_left:
                self._change_kind()  # the client's splats alone are better than what a picture would make of them
            if camera is not None and views.depth is not None:
                self._share = self._lasting.share(views.lack, camera, views.depth, appeared)
                reach = self._lasting.reach
        kind = self.kinds[0]
        coded = self._coded(kind, views, idr=idr or self._begin_anew)
        most = MOST_SHARE * self._target_bytes
        if most and len(coded.access_unit) > most:
            excess = len(coded.access_unit) / most
            if self._set_crf(self._crf + CRF_OF_DOUBLE * np.log2(excess)):
                coded = self._coded(kind, views, idr=True)
        coded = replace(coded, before=before, reach=reach if coded.kind is DIFFERENCE else HOLDS)
        self._begin_anew = False
        if not coded.idr:
            self._mean_bytes += (len(coded.access_unit) - self._mean_bytes) / min(self._counted + 1, RATE_WINDOW)
            self._counted += 1
        if len(self.kinds) > 1 and views.compared and self.compares and not light:
            self._try_other(coded, views, octaves)
        return coded

    def _coded(self, kind: ReferenceKind, views: ComparedViews, *, idr: bool) -> Coded:
        video = self._videos.get(kind)
        if video is None:
            video, idr = self._videos.setdefault(kind, _Video(self._opened())), True
        if kind is PICTURE:
            truth = views.truth
            unit, decoded = video.coded(truth, idr=idr)
            self._picture_left = _power((truth - decoded)[::LOOKED_AT, ::LOOKED_AT])
            return Coded(kind, unit, self._knee, is_idr(unit), after=self._picture_left)
        lack = views.lack if self._share is None else views.lack * self._share[..., None]
        loud, rms = _loud_blocks(lack)
        knee = self._knee = _knee(rms, self._knee)
        companded = views.companded(knee) if self._share is None else compand_by_table(lack, knee)
        if loud is not None:
            companded = np.asarray(cv2.copyTo(companded, loud, np.full_like(companded, ZERO)))
        if self._light:
            unit = video.unit(companded, idr=idr)
            return Coded(kind, unit, knee, is_idr(unit), after=None)
        unit, decoded = video.coded(companded, idr=idr)
        seen = decoded[::LOOKED_AT, ::LOOKED_AT]
        left = (lack[::LOOKED_AT, ::LOOKED_AT] - expand(seen, knee)).astype(np.float32)
        return Coded(kind, unit, knee, is_idr(unit), after=_power(left))

    def _try_other(self, used: Coded, views: ComparedViews, octaves: float) -> None:
        """Code the other kind beside the one in use, from time to time, and change over where it is better."""
        other = self.kinds[1]
        step = self._trial.step(used)
        if step is None:
            return
        if step == 0:
            self._videos.pop(other, None)
        tried = self._coded(other, views, idr=step == 0)
        if step and not used.idr:
            left = detail_left(views.truth, views.lack, octaves)
            finer = {DIFFERENCE: left.difference, PICTURE: left.picture}
            self._trial.count(*(_score(coded, finer[coded.kind]) for coded in (used, tried)))
        if self._trial.won:
            self._change_kind()

    def _change_kind(self) -> None:
        self.kinds = self.kinds[::-1]
        self._videos.pop(self.kinds[0], None)
        self._trial = _Trial()
        self._begin_anew = True

    def _follow_at_constant_rate(self, wanted_bps: int) -> None:
        if self._bps is None or not self._bps / RATE_STEP <= wanted_bps <= self._bps * RATE_STEP:
            self._bps = wanted_bps
            self._recode(self._crf)

    def _recode(self, crf: float) -> None:
        """Begin new videos, of another quality or rate.

        Where quality falls, the kind in use takes too many bytes: the other one is tried at once.
        """
        self._trial = _Trial(first=1 if crf > self._crf else TRIAL_EVERY)
        self._crf = crf
        self._videos.clear()
        self._mean_bytes, self._counted, self._begin_anew = 0.0, 0, True

    def _opened(self) -> H264Encoder:
        return H264Encoder(
            self.width_px,
            self.height_px,
            self._fps,
            crf=self._crf,
            light=self._light,
            chroma=self._chroma,
            max_bps=self._bps,
            buffer_s=BUFFER_S if self._settings.reference_full_size else 0.5,
        )


class _Trial:
    """A comparison of the two kinds, over a few references every now and then."""

    def __init__(self, first: int = TRIAL_EVERY) -> None:
        """The ``first`` reference is the first of a trial."""
        self._at = -first
        self._used: list[float] = []
        self._tried: list[float] = []
        self._lowest = np.inf  # score since the last trial began

    def step(self, used: Coded) -> int | None:
        """Of the trial under way: the number in it of the reference that was coded as ``used``; None between trials,
        which come every :data:`TRIAL_EVERY` references, or where the score of ``used`` has grown.
        """
        if self._grown(used):
            self._at = 0
        at, self._at = self._at, self._at + 1
        step = at % TRIAL_EVERY
        if at < 0 or step >= TRIAL_LENGTH:
            return None
        if step == 0:
            self._used, self._tried, self._lowest = [], [], np.inf
        return step

    def _grown(self, used: Coded) -> bool:
        if used.idr:
            return False
        score = _score(used)
        self._lowest = min(self._lowest, score)
        between = self._at < 0 or self._at % TRIAL_EVERY >= TRIAL_LENGTH
        return between and score > self._lowest + np.log(GROWN)

    def count(self, used: float, tried: float) -> None:
        """Scores of the two codings of one reference, by all that is shown."""
        self._used.append(used)
        self._tried.append(tried)

    @property
    def won(self) -> bool:
        """Whether the other kind is clearly better over a whole trial."""
        whole = len(self._tried) == TRIAL_LENGTH - 1
        return whole and float(np.mean(self._tried) - np.mean(self._used)) < np.log(BETTER)


def _score(coded: Coded, finer: float = 0.0) -> float:
    """Of a reference that was looked at; ``finer`` is what it leaves of detail finer than its pixels."""
    assert coded.after is not None
    return float(np.log(max(coded.after + finer, 1e-9)) + RATE_EXPONENT * np.log(max(len(coded.access_unit), 1)))


def _kinds(settings: ServerSettings, hello: Hello) -> tuple[ReferenceKind, ...]:
    """What both sides want, the one to begin with first."""
    wanted = {"auto": (PICTURE, DIFFERENCE), "difference": (DIFFERENCE,), "picture": (PICTURE,), "none": ()}
    kinds: tuple[ReferenceKind, ...] = wanted[settings.references]
    if hello.references == NO_REFERENCES:
        return ()
    return kinds if hello.references == ANY_REFERENCE else ((PICTURE,) if kinds else ())


def _power(picture: F32) -> float:
    return cv2.norm(picture, cv2.NORM_L2SQR) / picture.size


def _differing_share(lack: F32) -> float:
    """Share of blocks in which ``lack`` [h, w, 3] is not zero. Means over these treat a scene that fills a tenth of the
    picture like one that fills all of it.
    """
    return float((by_block(lack, lack) > NO_DIFFERENCE).mean())


def _loud_blocks(lack: F32) -> tuple[NDArray[np.uint8] | None, float]:
    """The pixels [h, w] of blocks in which there is enough of ``lack`` to be worth its bits (1 there; None: all), and
    the root mean square of these blocks.
    """
    height, width = lack.shape[:2]
    blocks = by_block(lack, lack)
    loud = blocks > QUIET
    if loud.all():
        return None, float(np.sqrt(blocks.mean()))
    rms = float(np.sqrt(blocks[loud].mean())) if loud.any() else 0.0
    worth = cv2.resize(loud.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
    return np.asarray(worth, np.uint8), rms


def _knee(rms: float, current: float) -> float:
    """The knee for differences of root mean square ``rms``; ``current`` where that will do."""
    best = max(KNEE_OF_RMS * rms, 1e-6)
    if current / KEEP_KNEE <= best <= current * KEEP_KNEE:
        return current
    return min(KNEES, key=lambda knee: abs(np.log(best / knee)))
