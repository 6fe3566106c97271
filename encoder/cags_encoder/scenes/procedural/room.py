"""The arrangement of the room. Metres, y up, the floor at y = 0, the window on the -x side."""

from __future__ import annotations

import numpy as np

from cags_common.geometry import F64, Vec3
from cags_encoder.scenes.procedural import textures as tex
from cags_encoder.scenes.procedural.light import Lighting
from cags_encoder.scenes.procedural.patches import Finish, Patch, ball, box, cushion, lathe, quad
from cags_encoder.scenes.procedural.textures import Noise, Rgb

HALF, HEIGHT = 2.4, 2.6
WINDOW_LOW: Vec3 = (-HALF, 0.9, -1.1)
WINDOW_HIGH: Vec3 = (-HALF, 2.2, 0.9)
PANES = (3, 2)
SUN = (-0.76, 0.57, 0.30)
LAMP: Vec3 = (1.95, 1.62, -1.95)

BACKING = Finish(detail=0.04)
"""For surfaces that are visible only between the splats of others."""

_BOOKS: tuple[Rgb, ...] = (
    (0.55, 0.13, 0.12), (0.14, 0.25, 0.42), (0.16, 0.36, 0.26), (0.75, 0.62, 0.35), (0.82, 0.78, 0.70),
    (0.35, 0.20, 0.30), (0.80, 0.42, 0.16), (0.20, 0.20, 0.22), (0.48, 0.55, 0.58),
)  # fmt: skip
_OAK: Rgb = (0.66, 0.46, 0.29)
_WALNUT: Rgb = (0.42, 0.27, 0.17)


def furnish(noise: Noise, rng: np.random.Generator) -> list[Patch]:
    """All static surfaces."""
    parts = [_shell, _window, _rug, _table, _sofa, _shelf, _sideboard, _pictures, _lamp, _pot]
    return [patch for part in parts for patch in part(noise, rng)]


def lighting() -> Lighting:
    """The room's lights and coarse occluders."""
    corner = (WINDOW_LOW[0], WINDOW_LOW[1], WINDOW_HIGH[2])
    edges = (0.0, 0.0, WINDOW_LOW[2] - WINDOW_HIGH[2]), (0.0, WINDOW_HIGH[1] - WINDOW_LOW[1], 0.0)
    sun = np.asarray(SUN) / np.linalg.norm(SUN)
    return Lighting((corner, *edges), PANES, (float(sun[0]), float(sun[1]), float(sun[2])), LAMP, _blockers(), _balls())


def _blockers() -> F64:
    h, t = HALF, 0.2
    (_, wy0, wz0), (_, wy1, wz1) = WINDOW_LOW, WINDOW_HIGH
    boxes = [
        ((-h - t, -t, -h - t), (h + t, 0, h + t)),
        ((-h - t, HEIGHT, -h - t), (h + t, HEIGHT + t, h + t)),
        ((-h - t, 0, -h - t), (h + t, HEIGHT, -h)),
        ((-h - t, 0, h), (h + t, HEIGHT, h + t)),
        ((h, 0, -h), (h + t, HEIGHT, h)),
        ((-h - t, 0, -h), (-h, wy0, h)),
        ((-h - t, wy1, -h), (-h, HEIGHT, h)),
        ((-h - t, wy0, -h), (-h, wy1, wz0)),
        ((-h - t, wy0, wz1), (-h, wy1, h)),
        ((-0.56, 0.40, -0.33), (0.56, 0.45, 0.33)),  # table
        ((-0.30, 0.14, -0.24), (0.30, 0.16, 0.24)),
        ((1.45, 0.10, -1.17), (2.40, 0.58, 1.17)),  # sofa
        ((2.08, 0.58, -0.9), (2.40, 1.08, 0.9)),
        ((-1.90, 0.0, -2.40), (-0.50, 1.92, -2.08)),  # shelf
        ((0.05, 0.06, -2.40), (1.55, 0.72, -1.96)),  # sideboard
        ((-2.05, 0.0, 1.40), (-1.65, 0.42, 1.80)),  # pot
        ((-0.36, 0.45, -0.06), (-0.20, 0.74, 0.10)),  # vase
        ((0.10, 0.45, -0.18), (0.42, 0.53, 0.14)),  # bowl
    ]
    return np.array(boxes, np.float64)


def _balls() -> F64:
    return np.array([(-1.85, 1.05, 1.6, 0.38), (1.35, 0.80, -2.15, 0.09)], np.float64)


def _shell(noise: Noise, rng: np.random.Generator) -> list[Patch]:
    h, y = HALF, HEIGHT
    varnish = Finish(gloss=0.10)
    plaster = tex.plain((0.87, 0.83, 0.76), noise)
    grey = tex.plain((0.6, 0.55, 0.5), noise)
    patches = [
        quad((-h, 0, h), (2 * h, 0, 0), (0, 0, -2 * h), tex.planks(noise), varnish),
        quad((-h, y, -h), (2 * h, 0, 0), (0, 0, 2 * h), tex.plain((0.92, 0.91, 0.88), noise), Finish(detail=0.5)),
        quad((-h, 0, -h), (2 * h, 0, 0), (0, y, 0), tex.wallpaper(noise)),
        quad((h, 0, h), (-2 * h, 0, 0), (0, y, 0), tex.plain((0.80, 0.72, 0.60), noise), Finish(detail=0.7)),
        quad((h, 0, -h), (0, 0, 2 * h), (0, y, 0), tex.bricks(noise)),
        quad((-h, -0.05, h), (2 * h, 0, 0), (0, 0, -2 * h), tex.plain((0.5, 0.34, 0.2), noise), BACKING),
        quad((-h, 0, -h - 0.05), (2 * h, 0, 0), (0, y, 0), tex.plain((0.35, 0.45, 0.43), noise), BACKING),
        quad((h + 0.05, 0, -h), (0, 0, 2 * h), (0, y, 0), tex.plain((0.6, 0.36, 0.27), noise), BACKING),
        quad((h, 0, h + 0.05), (-2 * h, 0, 0), (0, y, 0), grey, BACKING),
        quad((-h, y + 0.05, -h), (2 * h, 0, 0), (0, 0, 2 * h), grey, BACKING),
    ]
    (_, wy0, wz0), (_, wy1, wz1) = WINDOW_LOW, WINDOW_HIGH
    for low_y, high_y, low_z, high_z in ((0, wy0, -h, h), (wy1, y, -h, h), (wy0, wy1, -h, wz0), (wy0, wy1, wz1, h)):
        for inset, finish in ((0.0, Finish(detail=0.7)), (0.05, BACKING)):
            patches.append(
                quad((-h - inset, low_y, high_z), (0, 0, low_z - high_z), (0, high_y - low_y, 0), plaster, finish)
            )
    beam = tex.wood(_WALNUT, noise)
    for z in (-1.6, 0.0, 1.6):
        patches += box((-h, y - 0.13, z - 0.07), (h, y, z + 0.07), beam, sides="yzZ", finish=Finish(detail=0.6))
    return patches + _skirting(noise)


def _skirting(noise: Noise) -> list[Patch]:
    h, white = HALF, tex.plain((0.88, 0.86, 0.82), noise)
    thin = Finish(detail=0.7)
    return [
        *box((-h, 0, -h), (h, 0.1, -h + 0.02), white, sides="YZ", finish=thin),
        *box((-h, 0, h - 0.02), (h, 0.1, h), white, sides="Yz", finish=thin),
        *box((-h, 0, -h), (-h + 0.02, 0.1, h), white, sides="YX", finish=thin),
        *box((h - 0.02, 0, -h), (h, 0.1, h), white, sides="Yx", finish=thin),
    ]


def _window(noise: Noise, rng: np.random.Generator) -> list[Patch]:
    (x, y0, z0), (_, y1, z1) = WINDOW_LOW, WINDOW_HIGH
    white = tex.plain((0.93, 0.92, 0.90), noise)
    view = tex.landscape(noise, 6.0, 3.6, ((0.45, 0.68, 0.95), (0.88, 0.94, 1.0)), (0.36, 0.50, 0.28))
    patches = [
        quad((x - 0.9 - back, -0.2, 2.9), (0, 0, -6.0), (0, 3.6, 0), view, Finish(emission=1.08, detail=detail))
        for back, detail in ((0.0, 0.35), (0.1, 0.02))
    ]
    patches += box((x - 0.12, y0 - 0.04, z0 - 0.06), (x + 0.14, y0, z1 + 0.06), white, sides="YXzZy")  # the sill
    patches += [
        quad((x - 0.12, y0, z0), (0.12, 0, 0), (0, y1 - y0, 0), white),
        quad((x, y0, z1), (-0.12, 0, 0), (0, y1 - y0, 0), white),
        quad((x - 0.12, y1, z0), (0.12, 0, 0), (0, 0, z1 - z0), white),
    ]
    for i in range(PANES[0] + 1):
        z = z0 + (z1 - z0) * i / PANES[0]
        patches += box((x - 0.09, y0, z - 0.02), (x - 0.04, y1, z + 0.02), white, sides="XzZ")
    for j in range(PANES[1] + 1):
        y = y0 + (y1 - y0) * j / PANES[1]
        patches += box((x - 0.09, y - 0.02, z0), (x - 0.04, y + 0.02, z1), white, sides="XyY")
    return patches


def _rug(noise: Noise, rng: np.random.Generator) -> list[Patch]:
    return [quad((-1.3, 0.012, 0.95), (2.6, 0, 0), (0, 0, -1.9), tex.rug(noise, 1.3, 0.95), Finish(detail=2.6))]


def _table(noise: Noise, rng: np.random.Generator) -> list[Patch]:
    oak, gloss = tex.wood(_OAK, noise), Finish(gloss=0.22, detail=2.0)
    patches = box((-0.56, 0.405, -0.33), (0.56, 0.45, 0.33), oak, finish=gloss)
    patches += box((-0.48, 0.14, -0.26), (0.48, 0.16, 0.26), oak)
    for x, z in ((-0.5, -0.28), (-0.5, 0.24), (0.46, -0.28), (0.46, 0.24)):
        patches += box((x, 0, z), (x + 0.04, 0.41, z + 0.04), oak, sides="xXzZ")
    vase = [
        (0.0, 0.0),
        (0.05, 0.0),
        (0.082, 0.06),
        (0.09, 0.12),
        (0.07, 0.19),
        (0.035, 0.24),
        (0.032, 0.26),
        (0.05, 0.29),
    ]
    glaze = tex.stripes(((0.10, 0.22, 0.55), (0.90, 0.92, 0.95), (0.16, 0.34, 0.66), (0.90, 0.92, 0.95)), 0.09)
    patches.append(lathe((-0.28, 0.45, 0.02), vase, glaze, Finish(gloss=0.55, detail=3.0)))
    bowl = [(0.0, 0.005), (0.06, 0.005), (0.13, 0.035), (0.16, 0.08), (0.15, 0.08), (0.12, 0.04), (0.0, 0.02)]
    patches.append(
        lathe((0.26, 0.45, -0.02), bowl, tex.plain((0.24, 0.42, 0.40), noise), Finish(gloss=0.4, detail=2.5))
    )
    fruit: list[tuple[Vec3, float, Rgb]] = [
        ((0.21, 0.525, 0.03), 0.05, (0.95, 0.52, 0.10)),
        ((0.32, 0.525, 0.02), 0.048, (0.80, 0.12, 0.10)),
        ((0.27, 0.525, -0.08), 0.05, (0.55, 0.70, 0.16)),
        ((0.265, 0.59, -0.005), 0.045, (0.96, 0.78, 0.20)),
    ]
    patches += [ball(at, r, tex.plain(rgb, noise, 0.15), Finish(gloss=0.35, detail=3.0)) for at, r, rgb in fruit]
    for k in range(3):
        rgb, turn = _BOOKS[int(rng.integers(len(_BOOKS)))], 0.02 * k
        low, high = (-0.10 + turn, 0.45 + 0.03 * k, 0.08), (0.12 - turn, 0.479 + 0.03 * k, 0.29 - turn)
        patches += box(low, high, tex.plain(rgb, noise), sides="xXYzZ", finish=Finish(detail=3.0))
    return patches


def _sofa(noise: Noise, rng: np.random.Generator) -> list[Patch]:
    cloth, red = tex.fabric((0.78, 0.60, 0.28), noise), tex.fabric((0.55, 0.16, 0.14), noise)
    soft = Finish(detail=1.2)
    patches = box((1.47, 0.1, -1.0), (2.36, 0.40, 1.0), cloth, sides="xYzZ")
    for z in (-0.47, 0.47):
        patches.append(cushion((1.88, 0.46, z), (0.44, 0.12, 0.455), cloth, 0.3, soft))
        patches.append(cushion((2.22, 0.78, z), (0.16, 0.30, 0.45), cloth, 0.4, soft))
    for z in (-1.06, 1.06):
        patches.append(cushion((1.92, 0.40, z), (0.46, 0.24, 0.12), cloth, 0.4, soft))
        patches += box((1.55, 0, 0.85 * z - 0.03), (1.61, 0.1, 0.85 * z + 0.03), tex.wood(_WALNUT, noise), sides="xXzZ")
    patches.append(cushion((2.02, 0.70, -0.62), (0.10, 0.19, 0.20), red, 0.6, Finish(detail=2.0)))
    teal = tex.stripes(((0.16, 0.42, 0.44), (0.90, 0.86, 0.74)), 0.12)
    patches.append(cushion((2.02, 0.70, 0.60), (0.10, 0.19, 0.20), teal, 0.6, Finish(detail=2.0)))
    return patches


def _shelf(noise: Noise, rng: np.random.Generator) -> list[Patch]:
    x0, x1, z0, z1 = -1.9, -0.5, -2.39, -2.08
    walnut = tex.wood(_WALNUT, noise)
    patches = box((x0, 0, z0), (x0 + 0.03, 1.92, z1), walnut, sides="xXZ")
    patches += box((x1 - 0.03, 0, z0), (x1, 1.92, z1), walnut, sides="xXZ")
    patches.append(
        quad((x0, 0, z0), (x1 - x0, 0, 0), (0, 1.92, 0), tex.plain((0.2, 0.13, 0.09), noise), Finish(detail=0.5))
    )
    for y in (0.06, 0.50, 0.94, 1.38, 1.89):
        patches += box((x0, y, z0), (x1, y + 0.03, z1), walnut, sides="yYZ")
    for y in (0.09, 0.53, 0.97, 1.41):
        patches += _books(noise, rng, (x0 + 0.04, x1 - 0.05), y, z0)
    return patches


def _books(noise: Noise, rng: np.random.Generator, span: tuple[float, float], y: float, z: float) -> list[Patch]:
    patches: list[Patch] = []
    x = span[0]
    while x < span[1] - 0.06:
        width, height, depth = rng.uniform(0.025, 0.06), rng.uniform(0.22, 0.34), rng.uniform(0.18, 0.24)
        if rng.uniform() < 0.07:  # a gap, as in a used shelf
            x += 0.12
            continue
        spine = _spine(_BOOKS[int(rng.integers(len(_BOOKS)))], float(rng.uniform(0.2, 0.8)), height)
        patches += box((x, y, z), (x + width, y + height, z + depth), spine, sides="YZ", finish=Finish(detail=1.3))
        patches += box((x, y, z), (x + width, y + height, z + depth), spine, sides="xX", finish=Finish(detail=0.3))
        x += width + 0.002
    return patches


def _spine(rgb: Rgb, label: float, height: float) -> tex.Pattern:
    """The spine of a book: two gold lines around a paler label."""

    def pattern(x: F64, y: F64) -> F64:
        from_label = np.abs(y / height - label)
        colour = tex.mix(rgb, (0.83, 0.78, 0.62), tex.step(0.0, 0.09 - from_label, 0.02))
        return (
            tex.mix(colour, (0.86, 0.70, 0.32), tex.step(0.0, 0.012 - np.abs(from_label - 0.14), 0.015))
            + 0.0 * x[..., None]
        )

    return pattern


def _sideboard(noise: Noise, rng: np.random.Generator) -> list[Patch]:
    oak, lines = tex.wood(_OAK, noise), _doors(noise)
    patches = box((0.05, 0.06, -2.39), (1.55, 0.70, -1.96), oak, sides="xXY", finish=Finish(gloss=0.12))
    patches.append(quad((0.05, 0.06, -1.96), (1.50, 0, 0), (0, 0.64, 0), lines, Finish(gloss=0.12)))
    for x in (0.1, 1.45):
        patches += box((x, 0, -2.05), (x + 0.05, 0.06, -2.0), oak, sides="xXZ")
    patches.append(
        ball((1.35, 0.80, -2.15), 0.095, tex.plain((0.55, 0.58, 0.62), noise), Finish(gloss=0.8, detail=3.0))
    )
    urn = [(0.0, 0.0), (0.07, 0.0), (0.11, 0.1), (0.12, 0.2), (0.06, 0.32), (0.04, 0.36), (0.07, 0.40)]
    patches.append(
        lathe((0.28, 0.70, -2.18), urn, tex.plain((0.62, 0.30, 0.18), noise, 0.2), Finish(gloss=0.3, detail=2.0))
    )
    return patches


def _doors(noise: Noise) -> tex.Pattern:
    board = tex.wood(_OAK, noise)

    def pattern(x: F64, y: F64) -> F64:
        seam = np.abs(x / 0.5 - np.round(x / 0.5)) * 0.5
        rgb = board(y + 2.0, x) * (0.4 + 0.6 * tex.step(0.006, seam, 0.006))[..., None]
        knob = np.hypot(np.abs(seam) - 0.05, y - 0.34)
        return tex.mix(rgb, (0.85, 0.74, 0.45), tex.step(0.0, 0.016 - knob, 0.006))

    return pattern


def _pictures(noise: Noise, rng: np.random.Generator) -> list[Patch]:
    gold, black = tex.wood((0.80, 0.62, 0.30), noise), tex.plain((0.12, 0.11, 0.11), noise)
    sunset = tex.landscape(noise, 1.2, 0.8, ((0.25, 0.24, 0.45), (0.98, 0.62, 0.36)), (0.30, 0.20, 0.32))
    fine = Finish(detail=2.0)
    patches = box((0.20, 1.12, -2.39), (1.48, 2.00, -2.355), gold, sides="xXyY")
    patches += _frame_front((0.20, 1.12, -2.355), 1.28, 0.88, gold)
    patches.append(quad((0.24, 1.16, -2.36), (1.2, 0, 0), (0, 0.8, 0), sunset, fine))
    palette: tuple[Rgb, ...] = (
        (0.85, 0.20, 0.15),
        (0.95, 0.80, 0.25),
        (0.18, 0.35, 0.65),
        (0.93, 0.92, 0.88),
        (0.2, 0.55, 0.5),
    )
    for x in (1.7, 0.5):
        patches += box((x - 0.8, 1.15, 2.36), (x, 1.95, 2.39), black, sides="xXyYz")
        picture = tex.mosaic(noise, 0.11 + 0.05 * x, palette)
        patches.append(quad((x - 0.03, 1.18, 2.355), (-0.74, 0, 0), (0, 0.74, 0), picture, fine))
    panel = tex.wood((0.80, 0.78, 0.72), noise)
    patches.append(quad((-0.8, 0.0, 2.37), (-0.9, 0, 0), (0, 2.05, 0), panel, Finish(detail=0.8)))
    for y in (0.15, 1.05):
        patches += box((-1.62, y, 2.35), (-0.88, y + 0.8, 2.37), panel, sides="xXyYz")
    patches.append(ball((-0.88, 1.0, 2.32), 0.03, tex.plain((0.85, 0.72, 0.4), noise), Finish(gloss=0.5)))
    return patches


def _frame_front(corner: Vec3, width: float, height: float, pattern: tex.Pattern) -> list[Patch]:
    x, y, z = corner
    return [
        quad((x, y, z), (width, 0, 0), (0, 0.04, 0), pattern),
        quad((x, y + height - 0.04, z), (width, 0, 0), (0, 0.04, 0), pattern),
        quad((x, y, z), (0.04, 0, 0), (0, height, 0), pattern),
        quad((x + width - 0.04, y, z), (0.04, 0, 0), (0, height, 0), pattern),
    ]


def _lamp(noise: Noise, rng: np.random.Generator) -> list[Patch]:
    x, y, z = LAMP
    brass = tex.plain((0.70, 0.55, 0.28), noise)
    pole = [(0.0, 0.0), (0.16, 0.0), (0.16, 0.02), (0.015, 0.03), (0.015, y - 0.12)]
    shade = [(0.20, 0.0), (0.13, 0.28)]
    glow = tex.plain((1.0, 0.86, 0.60), noise)
    return [
        lathe((x, 0.0, z), pole, brass, Finish(gloss=0.4)),
        lathe((x, y - 0.15, z), shade, glow, Finish(emission=1.05)),
    ]


def _pot(noise: Noise, rng: np.random.Generator) -> list[Patch]:
    clay = [(0.0, 0.0), (0.14, 0.0), (0.19, 0.32), (0.21, 0.32), (0.21, 0.38), (0.18, 0.38), (0.175, 0.34), (0.0, 0.34)]
    return [lathe((-1.85, 0.0, 1.6), clay, tex.plain((0.70, 0.38, 0.25), noise, 0.15), Finish(detail=1.5))]
