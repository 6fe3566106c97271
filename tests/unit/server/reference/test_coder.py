"""What references say: differences, pictures, nothing; which of them; how well, as the link allows."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest

from cags_common.correction import StagedViews
from cags_common.correction.compander import expand
from cags_common.geometry import F32, Camera, Intrinsics, Pose
from cags_common.video.h264 import H264Decoder, is_idr
from cags_protocol.wire.limits import PROTOCOL_VERSION
from cags_protocol.wire.messages import Hello, ReferenceKind
from cags_server.reference.coder import FIRST_WINDOW, INVISIBLE, MOST_SHARE, RATE_WINDOW, ReferenceCoder
from cags_server.settings import ServerSettings

CLIENT = Intrinsics.of_fov(321, 241, 1.0, 0.8)
HELLO = Hello(PROTOCOL_VERSION, CLIENT, Pose.identity())
SMALL = ServerSettings(reference_width=96, reference_height=64)
PERIOD_US = 1e6 / 30


def coder(settings: ServerSettings = SMALL, **hello: str) -> ReferenceCoder:
    return ReferenceCoder(settings, replace(HELLO, **hello), 30)


def moving(count: int, size: tuple[int, int] = (64, 96), sigma_px: float = 3.0) -> list[F32]:
    """Pictures that move, as smooth as ``sigma_px``."""
    rng = np.random.default_rng(0)
    wall = cv2.GaussianBlur(rng.random((size[0] + count, size[1], 3), dtype=np.float32), (0, 0), sigma_px)
    wall = (wall - wall.min()) / (wall.max() - wall.min())
    return [np.ascontiguousarray(wall[i : i + size[0]]) for i in range(count)]


def power(picture: F32) -> float:
    return float(np.mean(np.square(picture)))


def test_references_are_as_large_as_asked_and_no_larger_than_the_display() -> None:
    display = replace(HELLO, intrinsics=Intrinsics.of_fov(800, 600, 1.0, 0.8))
    large = ReferenceCoder(ServerSettings(), display, 30)
    assert (large.width_px, large.height_px) == (400, 300)
    small, full = coder(ServerSettings()), coder(ServerSettings(reference_full_size=True))
    assert (small.width_px, small.height_px) == (320, 240), "even, as 4:2:0 must be"
    assert (full.width_px, full.height_px) == (320, 240), "even, as 4:2:0 must be"


def test_a_difference_brings_a_client_to_the_truth() -> None:
    truth = moving(3)
    difference, decoder = coder(replace(SMALL, references="difference", reference_crf=10.0)), H264Decoder()
    for number, picture in enumerate(truth):
        mirror = cv2.blur(picture, (9, 9))
        coded = difference.code(picture, mirror, idr=not number)
        decoded = decoder.decode(coded.access_unit)
        assert decoded is not None
        shown = mirror + expand(decoded, coded.knee)
        assert power(picture - shown) < power(picture - mirror) / 10
        assert coded.before == pytest.approx(power(picture - mirror), rel=1e-4)
        assert coded.after == pytest.approx(power(picture - shown), rel=0.3)  # looked at in a quarter of the pixels


def test_for_a_client_that_holds_nothing_the_difference_is_the_scene() -> None:
    truth, decoder = moving(1)[0], H264Decoder()
    coded = coder(replace(SMALL, references="difference", reference_crf=5.0)).code(truth, None, idr=True)
    decoded = decoder.decode(coded.access_unit)
    assert decoded is not None
    assert power(truth - expand(decoded, coded.knee)) < 1e-4


def test_nothing_is_sent_where_nothing_is_to_be_seen() -> None:
    one, (truth, later) = coder(), moving(2)
    coded = one.code(truth, truth + np.float32(0.5 * INVISIBLE**0.5), idr=True)
    assert coded.kind is ReferenceKind.NOTHING
    assert not coded.access_unit
    assert one.code(later, later * 0.8, idr=True).kind is ReferenceKind.PICTURE


def test_a_scene_that_fills_little_of_the_picture_is_corrected_as_one_that_fills_it() -> None:
    truth = np.zeros_like(moving(1)[0])
    truth[:16, :16] = 0.5
    lacking = np.zeros_like(truth)
    lacking[:16, :16] = 2 * INVISIBLE**0.5
    assert np.square(lacking).mean() < INVISIBLE, "over the whole picture it would not show"
    one = coder(replace(SMALL, references="difference"))
    assert one.code(truth, truth - lacking, idr=True).kind is ReferenceKind.DIFFERENCE
    assert one.code(truth, truth - lacking / 5, idr=False).kind is ReferenceKind.NOTHING


def test_what_is_alike_costs_nothing_and_stays_alike() -> None:
    """Where the client holds the truth, a difference that is needed elsewhere changes nothing."""
    truth, decoder = moving(1)[0], H264Decoder()
    mirror = truth.copy()
    mirror[:, 64:] *= 0.5
    coded = coder(replace(SMALL, references="difference")).code(truth, mirror, idr=True)
    decoded = decoder.decode(coded.access_unit)
    assert decoded is not None
    assert np.all(expand(decoded, coded.knee)[:, :48] == 0)


def test_pictures_serve_a_client_that_flickers_and_differences_one_that_is_good() -> None:
    rng = np.random.default_rng(1)
    auto, decoder, kinds = coder(), H264Decoder(), []
    truth = moving(1)[0]
    for number in range(180):
        noise = rng.normal(0, 0.25, (16, 24, 3)).astype(np.float32)
        poor = np.clip(truth + cv2.resize(noise, (96, 64), interpolation=cv2.INTER_NEAREST), 0, 1)
        good = np.clip(truth + 0.02 * np.sin(np.arange(96) / 9)[None, :, None], 0, 1).astype(np.float32)
        coded = auto.code(truth, good if 60 <= number < 120 else poor, idr=not number)
        assert decoder.decode(coded.access_unit) is not None, "a change of kind begins a new video"
        kinds.append(coded.kind)
    assert set(kinds[:60]) == {ReferenceKind.PICTURE}
    assert set(kinds[85:120]) == {ReferenceKind.DIFFERENCE}
    assert kinds[-1] is ReferenceKind.PICTURE
    assert sum(a is not b for a, b in pairwise(kinds)) == 2, "no to and fro"


@pytest.mark.parametrize(
    ("settings", "hello", "kinds"),
    [
        ("auto", "any", ("picture", "difference")),
        ("auto", "picture", ("picture",)),
        ("difference", "picture", ("picture",)),
        ("picture", "any", ("picture",)),
        ("none", "any", ()),
        ("auto", "none", ()),
    ],
)
def test_both_sides_say_what_they_can_use(settings: str, hello: str, kinds: tuple[str, ...]) -> None:
    assert coder(replace(SMALL, references=settings), references=hello).kinds == kinds


def test_without_references_nothing_is_coded() -> None:
    assert coder(replace(SMALL, references="none")).code(moving(1)[0], None, idr=True).kind is ReferenceKind.NOTHING


@pytest.mark.parametrize(("asked", "made"), [("yuv444p", "yuv444p"), ("yuv420p", "yuv420p")])
def test_the_clients_decoder_decides_on_colour_sampling(asked: str, made: str) -> None:
    import av

    unit = coder(chroma=asked).code(moving(1)[0], None, idr=True).access_unit
    frames = av.CodecContext.create("h264", "r")
    frames.thread_count = 1
    decoded = [*frames.decode(av.Packet(unit)), *frames.decode(None)]  # type: ignore[attr-defined]
    assert decoded[0].format.name == made


def test_quality_follows_the_link() -> None:
    one = coder(replace(SMALL, references="picture", reference_crf=18.0))
    sizes, wanted = [], 350.0
    slow_bps = wanted * 8e6 / PERIOD_US / 0.25
    for number, picture in enumerate(moving(260, sigma_px=0.8)):
        one.follow(slow_bps if 40 <= number < 180 else 1e8, PERIOD_US)
        sizes.append(len(one.code(picture, None, idr=not number).access_unit))
    assert np.mean(sizes[1:40]) > 2 * wanted
    assert np.mean(sizes[160:180]) < 1.3 * wanted, "less where the link is slow"
    assert np.mean(sizes[40 + FIRST_WINDOW : 40 + RATE_WINDOW]) < 1.5 * wanted, "at once where it is much too slow"
    assert np.mean(sizes[240:]) > 1.5 * np.mean(sizes[160:180]), "and again more where it is not"


def test_a_picture_that_stands_alone_is_coded_again_where_it_is_far_too_large() -> None:
    picture, sizes = moving(1, sigma_px=0.8)[0], []
    for link_bps in (6e5, 2e6, 1e8):
        one = coder(replace(SMALL, references="picture"))
        one.follow(link_bps, PERIOD_US)
        sizes.append(len(one.code(picture, None, idr=True).access_unit))
    most = MOST_SHARE * 6e5 * SMALL.reference_share * PERIOD_US / 8e6
    assert sizes[2] > 6 * most > 2 * sizes[0], "once: towards what the link bears"
    assert sizes[0] < sizes[1] < sizes[2]


def test_a_picture_that_would_block_a_thin_link_is_coded_again() -> None:
    """Four differences of ten times their share followed each other on such a link, and the media behind them stood."""
    link_bps = 6e5
    most = MOST_SHARE * link_bps * SMALL.reference_share * PERIOD_US / 8e6
    one, free = (coder(replace(SMALL, references="difference")) for _ in range(2))
    sizes, freely = [], []
    for number, truth in enumerate(moving(8, sigma_px=0.8)):
        mirror = truth + np.float32(0.002) if number < 3 else cv2.blur(truth, (5, 5))  # then it loses track
        one.follow(link_bps, PERIOD_US)
        sizes.append(len(one.code(truth, mirror, idr=not number).access_unit))
        freely.append(len(free.code(truth, mirror, idr=not number).access_unit))
    assert max(freely[3:]) > 3 * most
    assert max(sizes[4:]) < 1.5 * most


@pytest.mark.parametrize("bps", [300_000, 1_000_000, 4_000_000])
def test_whole_pictures_keep_to_their_share_of_the_link(bps: int) -> None:
    """Remote rendering."""
    one = coder(ServerSettings(reference_full_size=True, reference_share=0.8, reference_most=1.0, references="picture"))
    noise = np.random.default_rng(0).random((one.height_px + 60, one.width_px, 3)).astype(np.float32)
    units = []
    for number in range(60):
        one.follow(bps, PERIOD_US)
        units.append(one.code(noise[number : number + one.height_px], None, idr=not number).access_unit)
    assert sum(map(len, units[15:])) * 8 / 1.5 <= bps, "after the first picture, over a second and a half"


def test_a_changed_link_begins_a_new_video_of_whole_pictures() -> None:
    one = coder(ServerSettings(reference_full_size=True, reference_share=0.5, reference_most=1.0, references="picture"))
    decoder, begun = H264Decoder(), []
    for picture, link_bps in zip(moving(6, (240, 320)), (2e6, 2e6, 2.2e6, 8e6, 8e6, 1e6), strict=True):
        one.follow(link_bps, PERIOD_US)
        unit = one.code(picture, None, idr=False).access_unit
        begun.append(is_idr(unit))
        assert decoder.decode(unit) is not None
    assert begun == [True, False, False, True, False, True]


def test_where_references_come_late_pictures_are_sent_without_a_mirror_until_they_come_in_time() -> None:
    """A client has changed its splats by then: what it lacked is no longer what it lacks."""
    auto, truth = coder(), moving(1)[0]
    good = np.clip(truth + 0.02 * np.sin(np.arange(96) / 9)[None, :, None], 0, 1).astype(np.float32)
    kinds, compared = [], []
    for number in range(160):
        compared.append(auto.compares)
        kinds.append(auto.code(truth, good if auto.compares else None, idr=not number).kind)
        auto.lateness.observe(late=30 <= number < 60)
    assert kinds[28] is ReferenceKind.DIFFERENCE
    assert compared.index(False) in range(32, 40)
    assert {kind for kind, known in zip(kinds, compared, strict=True) if not known} == {ReferenceKind.PICTURE}
    assert kinds[-1] is ReferenceKind.DIFFERENCE


def test_a_light_reference_brings_about_as_much_and_a_change_of_care_begins_a_new_video() -> None:
    one, decoder = coder(replace(SMALL, references="difference", reference_crf=10.0)), H264Decoder()
    begun, left = [], {False: [], True: []}
    for number, picture in enumerate(moving(24)):
        light = 8 <= number < 16
        mirror = cv2.blur(picture, (9, 9))
        coded = one.code(picture, mirror, idr=not number, light=light)
        decoded = decoder.decode(coded.access_unit)
        assert decoded is not None
        left[light].append(power(picture - mirror - expand(decoded, coded.knee)))
        begun.append(is_idr(coded.access_unit))
        assert (coded.after is None) is light, "nobody looks at what it leaves"
    assert [number for number, anew in enumerate(begun) if anew] == [0, 8, 16]
    assert np.mean(left[True]) < 1.3 * np.mean(left[False])


def test_light_references_are_not_tried_in_another_way(monkeypatch: pytest.MonkeyPatch) -> None:
    one, coded = coder(), []
    monkeypatch.setattr(one, "_try_other", lambda *arguments: coded.append(arguments))
    for number, picture in enumerate(moving(30)):
        one.code(picture, cv2.blur(picture, (9, 9)), idr=not number, light=True)
    assert not coded
    one.code(picture, cv2.blur(picture, (9, 9)), idr=False)
    assert coded


def test_lightly_too_good_splats_end_pictures() -> None:
    """What takes no trial: the client's splats are better than what a picture would make of them."""
    one, truth = coder(), moving(12)
    kinds = []
    for number, picture in enumerate(truth):
        mirror = cv2.blur(picture, (25, 25)) if number < 6 else picture + np.float32(0.004)
        kinds.append(one.code(picture, mirror, idr=not number, light=True).kind)
    assert set(kinds[:6]) == {ReferenceKind.PICTURE}
    assert kinds[-1] is ReferenceKind.DIFFERENCE


def test_a_client_that_takes_differences_alone_is_compared_with_however_late_they_come() -> None:
    one = coder(replace(SMALL, references="difference"))
    for _ in range(50):
        one.lateness.observe(late=True)
    assert one.compares
    assert one.code(moving(1)[0], None, idr=True).kind is ReferenceKind.DIFFERENCE


def test_a_client_that_loses_track_of_what_moves_gets_pictures_within_a_few_references() -> None:
    """Between two trials the splats stop where they are: what moves on shows pictures best, and at once."""
    one, truth = coder(replace(SMALL, reference_crf=28.0)), moving(40, sigma_px=1.5)
    for number in range(12):
        one.code(truth[number], np.clip(truth[number] + np.float32(0.01), 0, 1), idr=not number, octaves=1.0)
    assert one.kind is ReferenceKind.DIFFERENCE
    kinds = [one.code(truth[number], truth[12], idr=False, octaves=1.0).kind for number in range(14, 24)]
    assert kinds[-1] is ReferenceKind.PICTURE


def test_a_fall_of_quality_does_not_put_pictures_off() -> None:
    """The client's splats begin to lag: differences take more bytes, quality falls, and the trial under way is void."""
    one, truth = coder(replace(SMALL, reference_crf=28.0)), moving(40, sigma_px=1.5)
    sizes = []
    for number in range(16):
        mirror = np.clip(truth[number] + np.float32(0.01), 0, 1)
        sizes.append(len(one.code(truth[number], mirror, idr=not number, octaves=1.0).access_unit))
    link_bps = 0.7 * np.mean(sizes[1:]) * 8e6 / PERIOD_US / SMALL.reference_share
    kinds = []
    for number in range(16, 24):
        one.follow(link_bps, PERIOD_US)
        kinds.append(one.code(truth[number], truth[number - 8], idr=False, octaves=1.0).kind)
    assert kinds[0] is ReferenceKind.DIFFERENCE
    assert kinds[-1] is ReferenceKind.PICTURE


@pytest.mark.parametrize(
    ("octaves", "kind"), [(0.0, ReferenceKind.DIFFERENCE), (1.0, ReferenceKind.PICTURE)], ids=["coarse", "fine"]
)
def test_wrong_detail_that_a_display_shows_speaks_for_pictures(octaves: float, kind: ReferenceKind) -> None:
    """What stands still is coded well as either; between the reference's pixels a difference leaves the false grain."""
    truth = moving(1)[0] * np.float32(0.6) + np.float32(0.2)
    grain = np.random.default_rng(3).normal(0, 0.05, truth.shape).astype(np.float32)
    one = coder(replace(SMALL, reference_crf=24.0))
    kinds = [one.code(truth, truth + grain, idr=not number, octaves=octaves).kind for number in range(50)]
    assert kinds[-1] is kind


def test_of_a_difference_only_what_lasts_is_sent() -> None:
    """A blob that is lacking from one pose alone would be shown from others."""
    one, other = (coder(replace(SMALL, references="difference", reference_crf=10.0)) for _ in range(2))
    truth = moving(1)[0]
    wrong = np.float32(0.03) * (moving(1, sigma_px=1.0)[0] - np.float32(0.5))
    blob = np.zeros_like(truth)
    cv2.circle(blob, (40, 30), 3, (0.06, 0.06, 0.06), -1)
    depth, camera = np.full(truth.shape[:2], 2.0, np.float32), Camera(Intrinsics.of_fov(96, 64, 1.0, 0.8), HELLO.pose)
    decoder = H264Decoder()
    for number, lack in enumerate((wrong, wrong + blob)):
        views = StagedViews(truth, truth - lack, depth)
        coded = one.code_views(views, idr=not number, camera=camera)
        whole = other.code_views(views, idr=not number)
        decoded = decoder.decode(coded.access_unit)
        assert decoded is not None
        said = expand(decoded, coded.knee)
        assert power(said - wrong) < power(wrong) / 2
        assert coded.before == whole.before, "what is lacking is told whole"
