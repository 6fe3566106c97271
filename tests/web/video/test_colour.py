"""Pictures that a browser hands out as RGB and not as planes (Firefox) are read as they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from support.node import run_tests

ORDERS = {"RGBA": "rgba", "RGBX": "rgbx", "BGRA": "bgra", "BGRX": "bgrx"}
WIDTH, HEIGHT, OFFSET, PADDING = 5, 3, 8, 12


def test_packed_pictures(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    pictures = []
    for name, order in ORDERS.items():
        rgb = rng.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
        rows = np.full((HEIGHT, 4 * WIDTH + PADDING), 99, np.uint8)
        pixels = rows[:, : 4 * WIDTH].reshape(HEIGHT, WIDTH, 4)
        for channel, letter in enumerate("rgb"):
            pixels[..., order.index(letter)] = rgb[..., channel]
        rows[:, : 4 * WIDTH] = pixels.reshape(HEIGHT, -1)
        data = [77] * OFFSET + rows.ravel().tolist()
        size = {"format": name, "width": WIDTH, "height": HEIGHT, "offset": OFFSET, "stride": rows.shape[1]}
        pictures.append({**size, "data": data, "rgb": rgb.ravel().tolist()})
    run_tests("colour", tmp_path, pictures=pictures)
