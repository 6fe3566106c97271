"""Numbers that two languages state, or packages that do not know each other: one is the source, the others are as it.

Python is the source. A constant is read from the text of the other side, so that none needs to be built or run.
"""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE, NATIVE = ROOT / "web" / "src", ROOT / "kernels" / "src" / "native"

OF_THE_PAGE = {
    ("wire/limits", "cags_protocol.wire.limits"): """PROTOCOL_VERSION SUPPORTED_VERSIONS SUBPROTOCOL MAX_HEADER_BYTES
        MAX_MESSAGE_BYTES MAX_BLOB_BYTES MAX_PARTIAL_MESSAGES MAX_PARTIAL_BYTES MAX_POSE_SAMPLES MAX_ACK_RANGES
        MAX_EVICTED_TILES MAX_TEXT_BYTES""",
    ("wire/limits", "cags_common.tiles.lod"): "MAX_LODS",
    ("wire/cadence", "cags_protocol.cadence"): "EVERY_FRAME LEAST_PERMILLE",
    ("wire/assembly", "cags_protocol.sessions.blobs"): "CODEBOOKS_BLOB BASE_CODEBOOKS_BLOB MAX_BLOBS_AT_ONCE",
    ("wire/session", "cags_protocol.sessions.client"): "MAX_PENDING_EVICTIONS MAX_DAMAGED",
    ("wire/inventory", "cags_protocol.wire.inventory"): "MAX_INVENTORY_TILES",
    ("player/quality", "cags_client.playback.quality"): """SPLAT_SHARE DOWN_AFTER_US UP_AFTER_US UP_AFTER_MOST_US
        SMOOTHING_US HITCH UP_SHARE LEAST_GAIN WORTH_GAIN SLOW HEADROOM MOST_FALL STEADY LEAST_PICTURES EVEN_PICTURES
        CAUTION""",
    ("player/player", "cags_client.playback.interactive"): "SEEK_PATIENCE_US JUMP_US",
    ("player/player", "cags_protocol.wire.limits"): "MOST_SAMPLES=MAX_POSE_SAMPLES",
    ("player/startup", "cags_client.playback.startup"): "QUIET_US UNREFINED_QUIET_US PREVIEW_EVERY_US",
    ("player/camera", "cags_common.bundle.first_view"): "MARGIN BULK LEAST_RADIUS LEAST_SHARE",
    ("playback/references", "cags_client.store.references"): "KEPT LATEST",
    ("playback/references", "cags_client.frame.pipeline"): "PATIENCE_FRAMES",
    ("playback/reach", "cags_common.correction.reach"): "FADES",
    ("source/reconnect", "cags_client.net.reconnect"): "FIRST_DELAY_US MAX_DELAY_US GROWTH JITTER",
    ("source/live", "cags_client.playback.player"): "KEYFRAME_RETRY_US",
    ("source/decodeQueue", "cags_client.playback.decode_queue"): "MAX_UNDECODED_BYTES",
    ("source/changes", "cags_client.frame.changes"): "REMEMBERED SEEN_SIGMAS MOST_LOOKED_AT MOVED_PX",
    ("decode/packing", "cags_common.splats"): "MAX_SPLATS",
    ("decode/splats", "cags_common.splats"): "SH_REST_OF_DEGREE",
    ("gpu/layout", "cags_common.splats"): "SH_REST_OF_DEGREE",
    ("decode/splats", "cags_common.tiles.attributes"): "SH_REST_ATTRIBUTES",
    ("decode/updates", "cags_common.tiles.updates"): "UPDATE_VERSION UPDATE_COLUMNS RAMP_COLUMNS LONGEST_RAMP",
    ("store/ramps", "cags_common.tiles.ramps"): "OF_LOOKS",
    ("decode/tiles", "cags_common.tiles.payloads"): "BASE_VERSION MAX_TILE_SPLATS MAX_POSITION_BITS MAX_POSITION",
    ("decode/positions", "cags_common.tiles.lod"): "MAX_POSITION_LAYERS POSITION",
    ("decode/manifest", "cags_common.bundle.manifest"): "VERSION MAX_MANIFEST_BYTES MAX_FRAMES MAX_WHOLE_SPLATS",
    ("decode/manifest", "cags_common.bundle.view"): "MAX_TITLE FARTHEST_M",
    ("decode/contexts", "cags_common.tiles.contexts"): "MAX_CODE_BITS MAX_PREFIX_BITS MAX_LANES SYMBOLS_A_LANE",
    ("decode/codebooks", "cags_common.tiles.svq"): "MAX_BASE_BITS MAX_LAYER_BITS MAX_STAGE_BITS MAX_CODEBOOK_BYTES",
    ("decode/dequantise", "cags_kernels.codec"): "COLUMNS",
    ("store/reorderBuffer", "cags_common.store.reorder_buffer"): "MAX_WAITING_BYTES",
    ("store/gofTiles", "cags_common.store.gof_tiles"): """MAX_LATE_BYTES MAX_TILES_PER_GOF MAX_KEPT_SPLATS
        KEPT_SPLAT_BYTES REPLAY_AHEAD""",
    ("motion/chunk", "cags_common.motion.chunk"): """MOTION_VERSION=VERSION LEVELS REFINEMENT MAX_SPAN MAX_SPLATS
        MAX_SAMPLES MAX_FINER FADE_STEP""",
    ("motion/chunk", "cags_common.motion.symbols"): "MAX_ESCAPES ESCAPE LIFE_EDGES",
    ("motion/knots", "cags_common.motion.knots"): "FRACTION_BITS WEIGHT_BITS",
    ("motion/knots", "cags_common.motion.contexts"): "MAGNITUDE EDGES=_EDGES",
    ("motion/knots", "cags_common.motion.neighbours"): "MOST_SPREAD",
    ("motion/apply", "cags_common.motion.apply"): "ABSENT_LOGIT",
    ("gpu/graph", "cags_gpu.graph"): "MAX_GROUPS RADIX_BITS BLOCK",
    ("gpu/scene", "cags_gpu.scene"): "STAGED_BYTES",
    ("gpu/scene", "cags_common.correction.base"): "CELL_PX",
    ("gpu/renderer", "cags_common.correction.base"): "CELL_PX",
    ("gpu/renderer", "cags_gpu.correct"): "LEAST_BOXES",
    ("gpu/workspace", "cags_gpu.workspace"): "LEAST_CAPACITY HEADROOM CROWDED",
    ("gpu/layout", "cags_gpu.layout"): "TILE_PX BRIGHTEST FIXED_RANGE_PX",
    ("gpu/layout", "cags_common.correction.base"): "VETO_CELL_PX",
}
OF_THE_KERNELS = {
    (
        "motion/symbols.h",
        "cags_common.coding.rans",
    ): """kProbabilityBits=PROBABILITY_BITS kTotal=TOTAL kMaxLanes=MAX_LANES
        kMaxTables=MAX_TABLES""",
    ("motion/symbols.cpp", "cags_common.coding.tables"): "kHalvings=HALVINGS kFinest=FINEST kMaxRice=MAX_RICE",
    ("motion/tree.cpp", "cags_common.motion.chunk"): "kMaxSamples=MAX_SAMPLES",
    ("motion/tree.cpp", "cags_common.motion.knots"): "kFractionBits=FRACTION_BITS kWeightBits=WEIGHT_BITS",
    ("motion/tree.cpp", "cags_common.motion.symbols"): "kEscape=ESCAPE",
    (
        "motion/tree.cpp",
        "cags_common.motion.contexts",
    ): "kMagnitude=MAGNITUDE kClasses=CLASSES kRealClasses=REAL_CLASSES",
    (
        "motion/neighbours.cpp",
        "cags_common.motion.neighbours",
    ): "kWindow=WINDOW kTiny=_TINY kRidge=RIDGE kFurthest=FURTHEST",
    ("motion/neighbours.h", "cags_common.motion.neighbours"): "kFirstGroups=FIRST_GROUPS kFirstFiner=FIRST_FINER",
    ("motion/tree.cpp", "cags_common.motion.neighbours"): "kMostSpread=MOST_SPREAD kSpread=SPREAD",
    ("motion/cags_motion.h", "cags_common.motion.neighbours"): "CAGS_NEIGHBOURS=COUNT CAGS_FIT=FIT",
    ("motion/apply.cpp", "cags_common.motion.apply"): "kAbsentLogit=ABSENT_LOGIT",
    ("motion/cags_motion.h", "cags_common.motion.chunk"): "CAGS_MAX_SPAN=MAX_SPAN CAGS_MAX_TILE_SPLATS=MAX_SPLATS",
    ("motion/cags_motion.h", "cags_common.tiles.payloads"): "CAGS_MAX_TILE_SPLATS=MAX_TILE_SPLATS",
    ("codec/unpack.h", "cags_common.tiles.svq"): "kMostBits=MAX_LAYER_BITS",
    ("raster/abi.cpp", "cags_common.raster.checks"): "kMaxSide=MAX_SIDE_PX",
    ("raster/layout.h", "cags_common.raster.definition"): "kJacobianMargin=JACOBIAN_MARGIN",
}
OF_PYTHON = [
    ("cags_kernels.raster.MAX_SIDE_PX", "cags_common.raster.checks.MAX_SIDE_PX"),
    ("cags_kernels.motion.MAX_TABLES", "cags_common.coding.rans.MAX_TABLES"),
    ("cags_kernels.correct.VETO_CELL_PX", "cags_common.correction.base.VETO_CELL_PX"),
    ("cags_kernels.codec.MOST_BITS", "cags_common.tiles.svq.MAX_STAGE_BITS"),
    ("cags_client.output.page.shaper_control.MAX_LINE_BYTES", "cags_shaper.control.MAX_LINE_BYTES"),
    ("cags_encoder.bundles.publish.MAX_BLOB_BYTES", "cags_protocol.wire.limits.MAX_BLOB_BYTES"),
]


def pairs(table: dict[tuple[str, str], str]) -> list[tuple[str, str, str, str]]:
    """File, name there, Python module, name there."""
    each = [(file, module, name) for (file, module), names in table.items() for name in names.split()]
    return [(file, name.split("=")[0], module, name.split("=")[-1]) for file, module, name in each]


def number(expression: str, known: dict[str, Any]) -> Any:
    """What a constant's right side comes to: numbers, strings and lists of them, and constants before it."""
    text = re.sub(r"(?<=[0-9])'(?=[0-9])|\bint64_t(?=\{)| as const$", "", expression.strip())
    text = re.sub(r"\{([^{}]*)\}", r"(\1)", text)
    text = re.sub(r"(?<=[0-9.])[fu]\b", "", text)
    return eval(text, {"__builtins__": {}}, known)


def of_page(file: str) -> dict[str, Any]:
    """The constants of a module of the page that are plain enough."""
    found: dict[str, Any] = {}
    text = (PAGE / f"{file}.ts").read_text()
    for name, right in re.findall(r"^(?:export )?const ([A-Z][A-Z0-9_]*)(?:: [^=]+)? = ([^;]+);", text, re.MULTILINE):
        try:
            found[name] = number(right, found)
        except (SyntaxError, NameError, TypeError, AttributeError):
            continue
    return found


def of_kernels(file: str) -> dict[str, Any]:
    """The constants of a file of the kernels that are plain enough, and its enumerators with values."""
    found: dict[str, Any] = {}
    text = re.sub(r"//.*", "", (NATIVE / file).read_text())
    lists = re.findall(r"^(?:inline )?constexpr \w+ (k[^;(\[]+);", text, re.MULTILINE)
    lists += re.findall(r"^enum \w+ : int32_t \{([^}]*)\}", text, re.MULTILINE)
    for name, right in (item.split("=", 1) for items in lists for item in items.split(",") if "=" in item):
        try:
            found[name.strip()] = number(right, found)
        except (SyntaxError, NameError, TypeError):
            continue
    return found


def of_python(module: str, name: str) -> Any:
    return getattr(importlib.import_module(module), name)


def same(here: Any, there: Any) -> bool:
    return np.shape(here) == np.shape(there) and bool(np.all(np.asarray(here) == np.asarray(there)))


@pytest.mark.parametrize(("file", "name", "module", "source"), pairs(OF_THE_PAGE))
def test_the_page_states_what_python_does(file: str, name: str, module: str, source: str) -> None:
    constants = of_page(file)
    assert name in constants, f"web/src/{file}.ts has no plain constant {name}"
    assert same(constants[name], of_python(module, source))


@pytest.mark.parametrize(("file", "name", "module", "source"), pairs(OF_THE_KERNELS))
def test_the_kernels_state_what_python_does(file: str, name: str, module: str, source: str) -> None:
    constants = of_kernels(file)
    assert name in constants, f"kernels/src/native/{file} has no plain constant {name}"
    assert same(constants[name], of_python(module, source))


@pytest.mark.parametrize(("one", "other"), OF_PYTHON)
def test_packages_that_do_not_know_each_other_state_the_same(one: str, other: str) -> None:
    assert of_python(*one.rsplit(".", 1)) == of_python(*other.rsplit(".", 1))


def test_delays_of_the_page_are_the_clients_defaults() -> None:
    from cags_client.settings import ClientSettings

    made, player = ClientSettings(), of_page("player/player")
    assert player["START_DELAY_US"] == of_page("source/live")["RESUME_DELAY_US"] == made.start_delay_ms * 1000
    assert of_page("player/startup")["STARTUP_US"] == made.startup_ms * 1000
    assert player["REFERENCE_AGE"] == made.reference_age


def test_two_modules_of_the_page_state_no_constant_of_the_wire_twice() -> None:
    stated: dict[str, list[str]] = {}
    for path in sorted((PAGE / "wire").glob("*.ts")):
        for name in re.findall(r"^(?:export )?const ([A-Z][A-Z0-9_]*) = [0-9]", path.read_text(), re.MULTILINE):
            stated.setdefault(name, []).append(path.name)
    assert {name: files for name, files in stated.items() if len(files) > 1} == {}
