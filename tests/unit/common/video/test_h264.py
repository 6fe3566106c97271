import cv2
import numpy as np
import pytest
from av.video.codeccontext import VideoCodecContext

from cags_common.errors import DecodeError
from cags_common.video import h264
from cags_common.video.colour import Chroma
from cags_common.video.h264 import MAX_ACCESS_UNIT_BYTES, H264Decoder, H264Encoder, is_idr, nal_types

WIDTH, HEIGHT = 64, 48


def moving_images(count: int) -> list[np.ndarray]:
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
    return [
        np.stack([0.5 + 0.4 * np.sin((x + 2 * i) / 9), 0.5 + 0.4 * np.cos(y / 7), x / WIDTH], axis=-1)
        for i in range(count)
    ]


def psnr_db(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((a - b) ** 2)))


@pytest.mark.parametrize("chroma", list(Chroma))
def test_every_access_unit_gives_its_own_picture_at_once(chroma: Chroma) -> None:
    encoder, decoder = H264Encoder(WIDTH, HEIGHT, 30, crf=14, chroma=chroma), H264Decoder()
    for image in moving_images(8):
        decoded = decoder.decode(encoder.encode(image))
        assert decoded is not None
        assert decoded.dtype == np.float32
        assert psnr_db(decoded, image) > 34


def coded(images: list[np.ndarray], crf: float) -> tuple[int, float]:
    """Bytes in all, and the mean PSNR, of pictures after the first."""
    encoder, decoder = H264Encoder(WIDTH * 2, HEIGHT * 2, 30, crf=crf, chroma=Chroma.FULL), H264Decoder()
    units = [encoder.encode(image) for image in images]
    errors = [np.mean((decoder.decode(unit) - image) ** 2) for unit, image in zip(units, images, strict=True)]
    return sum(map(len, units[1:])), float(-10 * np.log10(np.mean(errors[1:])))


def test_closeness_counts_and_not_the_look_of_texture(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against the preset as it comes: closer by at least 2 dB in fewer bytes, for motion by parts of a pixel."""
    texture = np.random.default_rng(0).uniform(0.1, 0.9, (60, 80, 3)).astype(np.float32)
    y, x = np.mgrid[0 : HEIGHT * 2, 0 : WIDTH * 2].astype(np.float32) * np.float32(0.4)
    images = [cv2.remap(texture, x + 0.13 * i, y + 0.07 * i, cv2.INTER_CUBIC).clip(0, 1) for i in range(10)]
    size, closeness = coded(images, 27)
    opened = h264._open_encoder

    def as_it_comes(width: int, height: int, fps: float, chroma: Chroma, options: dict[str, str]) -> VideoCodecContext:
        params = options["x264-params"].removesuffix(h264.EXACT)
        return opened(width, height, fps, chroma, {**options, "tune": "zerolatency", "x264-params": params})

    monkeypatch.setattr(h264, "_open_encoder", as_it_comes)
    usual_size, usual_closeness = coded(images, 24)
    assert size < usual_size
    assert closeness > usual_closeness + 2


def test_only_the_first_and_the_asked_for_pictures_are_idr() -> None:
    encoder = H264Encoder(WIDTH, HEIGHT, 30)
    kinds = [is_idr(encoder.encode(image, idr=i == 3)) for i, image in enumerate(moving_images(6))]
    assert kinds == [True, False, False, True, False, False]


def test_a_decoder_starts_at_any_idr_and_ignores_what_comes_before() -> None:
    encoder = H264Encoder(WIDTH, HEIGHT, 30)
    images = moving_images(6)
    units = [encoder.encode(image, idr=i == 3) for i, image in enumerate(images)]
    decoder = H264Decoder()
    decoded = [decoder.decode(unit) for unit in units[1:]]
    assert [picture is None for picture in decoded] == [True, True, False, False, False]
    assert psnr_db(decoded[-1], images[-1]) > 30


def test_reset_waits_for_the_next_idr() -> None:
    encoder, decoder = H264Encoder(WIDTH, HEIGHT, 30), H264Decoder()
    first, second = (encoder.encode(image) for image in moving_images(2))
    assert decoder.decode(first) is not None
    decoder.reset()
    assert decoder.decode(second) is None


def test_equal_input_gives_equal_bytes() -> None:
    streams = []
    for _ in range(2):
        encoder = H264Encoder(WIDTH, HEIGHT, 30)
        streams.append([encoder.encode(image) for image in moving_images(5)])
    assert streams[0] == streams[1]


def test_the_rate_cap_holds() -> None:
    rng = np.random.default_rng(1)
    images = [rng.random((HEIGHT, WIDTH, 3)).astype(np.float32) for _ in range(30)]
    free, capped = H264Encoder(WIDTH, HEIGHT, 30, crf=10), H264Encoder(WIDTH, HEIGHT, 30, crf=10, max_bps=200_000)
    free_bytes, capped_bytes = (sum(len(e.encode(image)) for image in images) for e in (free, capped))
    assert free_bytes * 8 > 3 * 200_000
    assert capped_bytes * 8 < 2 * 200_000  # one second's worth, with room for the first picture's buffer


def test_colours_are_tagged_in_the_stream() -> None:
    import av

    unit = H264Encoder(WIDTH, HEIGHT, 30).encode(moving_images(1)[0])
    context = av.CodecContext.create("h264", "r")
    frames = context.decode(av.Packet(unit)) + context.decode(None)
    tags = (frames[0].colorspace, frames[0].color_range, frames[0].color_primaries, frames[0].color_trc)
    assert tuple(int(tag) for tag in tags) == (1, 1, 1, 13)


@pytest.mark.parametrize("keep", [0, 3, 20, 0.5, 0.99])
def test_a_truncated_access_unit_is_refused(keep: float) -> None:
    unit = H264Encoder(WIDTH, HEIGHT, 30).encode(moving_images(1)[0])
    size = keep if keep > 1 else int(len(unit) * keep)
    with pytest.raises(DecodeError, match=r"H\.264 access unit"):
        H264Decoder().decode(unit[: int(size)])


def test_after_damage_the_decoder_waits_for_an_idr() -> None:
    encoder, decoder = H264Encoder(WIDTH, HEIGHT, 30), H264Decoder()
    units = [encoder.encode(image, idr=i == 2) for i, image in enumerate(moving_images(3))]
    with pytest.raises(DecodeError):
        decoder.decode(units[0][: len(units[0]) // 2])
    assert decoder.decode(units[1]) is None
    assert decoder.decode(units[2]) is not None


def test_oversized_input_and_pictures_are_refused() -> None:
    with pytest.raises(DecodeError, match="must hold"):
        H264Decoder().decode(bytes(MAX_ACCESS_UNIT_BYTES + 1))
    unit = H264Encoder(WIDTH, HEIGHT, 30).encode(moving_images(1)[0])
    with pytest.raises(DecodeError):
        H264Decoder(max_pixels=WIDTH * HEIGHT // 4).decode(unit)


@pytest.mark.parametrize(
    ("width", "height", "options", "words"),
    [(0, 48, {}, "picture size"), (63, 48, {}, "even"), (64, 48, {"crf": 60}, "crf"), (99_999, 99_999, {}, "pixels")],
)
def test_impossible_settings_are_refused(width: int, height: int, options: dict[str, float], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        H264Encoder(width, height, 30, **options)


def test_an_image_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match="shape"):
        H264Encoder(WIDTH, HEIGHT, 30).encode(np.zeros((HEIGHT, WIDTH + 2, 3), np.float32))


def test_odd_sizes_work_with_full_chroma() -> None:
    image = moving_images(1)[0][:47, :63]
    decoded = H264Decoder().decode(H264Encoder(63, 47, 30, chroma=Chroma.FULL).encode(image))
    assert decoded is not None
    assert decoded.shape == image.shape


def test_nal_types_reads_start_codes_of_both_lengths() -> None:
    assert list(nal_types(b"\x00\x00\x00\x01\x67ab\x00\x00\x01\x68c\x00\x00\x01\x65")) == [7, 8, 5]
    assert list(nal_types(b"\x00\x00\x01")) == []
