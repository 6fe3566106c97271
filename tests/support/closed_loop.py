"""A server and its clients at the level of messages: what is sent in which order, and what each makes of it."""

from __future__ import annotations

import uuid
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np

from cags_common.bundle import BundleReader
from cags_common.coding.packing import decode_ids, encode_ids
from cags_common.motion.apply import ABSENT_LOGIT
from cags_common.splats import Splats
from cags_common.store.tile_decode import Arrival
from cags_common.store.tile_store import TileStore
from cags_common.tiles.inventory import InventoryEntry
from cags_common.tiles.splat_buffer import MOVING_COLUMNS
from cags_encoder import EncodeSettings, encode
from cags_protocol.wire.messages import FrameEnd, TileLayers
from cags_server.reference.mirror import Mirror
from cags_server.scene.library import SceneLibrary
from support.codec_scenes import cloud, with_changes

Key = tuple[int, int]


class KeptScene:
    """A renderer's copy of splats, which nobody draws."""

    def __init__(self, splats: Splats) -> None:
        self.splats = copied(splats)

    def update(self, rows: np.ndarray, splats: Splats, threads: int = 1) -> None:
        for (_, mine), (_, theirs) in zip(self.splats.arrays(), splats.arrays(), strict=True):
            mine[rows] = theirs[rows]

    def move(self, rows: np.ndarray, splats: Splats, threads: int = 1) -> None:
        for name in MOVING_COLUMNS:
            getattr(self.splats, name)[rows] = getattr(splats, name)[rows]


def served(reader: BundleReader, decoded_bytes: int) -> SceneLibrary:
    """A bundle that clients share, with a renderer that draws nothing."""
    rasteriser: Any = SimpleNamespace(name="kept", load=KeptScene)
    return SceneLibrary(reader, rasteriser, decoded_bytes)


@cache
def encoded_clip(codec: str) -> BundleReader:
    """A few frames of a cloud, of which some moves and some comes and goes."""
    whole, frames = cloud(120, 7), []
    for k in range(6):
        means = whole.means.copy()
        means[:30, 1] += np.float32(0.1 * k)
        frames.append(with_changes(whole, means=means).take(np.arange(120 - 5 * k)))
    url = f"memory://{uuid.uuid4().hex}"
    encode(frames, EncodeSettings(codec=codec, train_splats=256, lod_order="paper", gof_frames=3), url)
    return BundleReader.open(url)


@dataclass(frozen=True)
class Marked:
    """A mark on the wire."""

    number: int
    restart: bool = False


@dataclass(frozen=True)
class Referenced:
    """What the server drew for a reference: the splats of its mirror, None where there were none."""

    frame: int
    basis: int
    splats: Splats | None


Wire = tuple[TileLayers | FrameEnd | Marked | Referenced, bytes]


@dataclass
class Client:
    """Takes the wire in batches of any size, as a player does: tiles, then ends, up to the next mark."""

    reader: BundleReader
    rng: np.random.Generator
    store: TileStore = field(init=False)
    references: list[Referenced] = field(default_factory=list)
    wire: list[Wire] = field(default_factory=list)
    """Not read yet."""
    waits: int = 0
    """Jumps by which it forgot everything that the server has not answered: what comes before that is ignored."""
    shown: int = 0
    exact_from: int = 0
    """The least mark of which a reference is exact: all that had come was shown without regard to marks."""
    offset: int = 0
    """What is added to the numbers of this connection's marks, which begin with 1 on each."""
    newest: int = 0

    def __post_init__(self) -> None:
        self.store = TileStore(self.reader.manifest, self.reader.codec, threads=1)

    def read(self, count: int) -> None:
        """Take the next ``count`` messages of the wire, in batches of random size."""
        batch, self.wire = self.wire[:count], self.wire[count:]
        while batch:
            size = int(self.rng.integers(1, len(batch) + 1))
            self._take(batch[:size])
            batch = batch[size:]

    def _take(self, batch: list[Wire]) -> None:
        tiles: list[Wire] = []
        ends: list[Wire] = []
        for message, payload in batch:
            if self.waits and not isinstance(message, Marked):
                continue
            if isinstance(message, TileLayers):
                tiles.append((message, payload))
            elif isinstance(message, FrameEnd):
                ends.append((message, payload))
            elif isinstance(message, Referenced):
                self.references.append(message)
            else:
                self._decode(tiles, ends)
                tiles, ends = [], []
                self.waits -= message.restart
                self.newest = message.number + self.offset
                assert self.store.mark(self.newest) == []
        self._decode(tiles, ends)

    def _decode(self, tiles: list[Wire], ends: list[Wire]) -> None:
        arrivals = [Arrival(m.frame, m.tile, m.from_lod, m.split(data)) for m, data in tiles]  # type: ignore[union-attr]
        while arrivals:
            size = int(self.rng.integers(1, len(arrivals) + 1))
            assert self.store.add_all(arrivals[:size]) == []
            arrivals = arrivals[size:]
            if self.rng.random() < 0.5:
                assert self.store.flush() == []
        assert self.store.flush() == []
        for message, data in ends:
            removed = decode_ids(data) if data else np.zeros(0, np.int32)
            self.store.end(message.frame, removed)  # type: ignore[union-attr]

    def show(self, frame: int, basis: int | None) -> None:
        """Commit a frame, by a mark of this connection or with all that has come."""
        buffer = self.store._gofs.get(self.reader.manifest.gof_of(frame))
        replays = buffer is not None and (buffer._resting or frame < buffer.shown_frame)
        self.shown = frame
        self.store.commit(frame, None if basis is None else basis + self.offset)
        if replays and self.store.on_display is buffer:
            self.exact_from = 0
        if basis is None:
            self.exact_from = self.newest + 1 - self.offset

    def jump(self, frame: int, *, keeps: bool) -> None:
        """Go to ``frame``; what is held is kept, or forgotten until the server says that it has, too."""
        self.references.clear()
        self.shown = frame
        if not keeps:
            self.store.reset(frame)
            self.waits, self.exact_from = self.waits + 1, 0

    def reconnect(self, inventory: list[InventoryEntry]) -> None:
        """Another connection begins with ``inventory``; what the one before still carried is lost."""
        self.wire.clear()
        self.references.clear()
        self.offset, self.exact_from = self.newest, 0
        self.store.restarted(inventory)


@dataclass
class Sender:
    """Sends layers in any order, some again, and some of them never, over one connection."""

    library: SceneLibrary
    rng: np.random.Generator
    client: Client
    mirror: Mirror = field(init=False)
    sent: dict[Key, int] = field(default_factory=dict)
    """LoDs that have been sent, a bit each."""
    ended: int = -1

    def __post_init__(self) -> None:
        self.connect(())

    def connect(self, inventory: tuple[InventoryEntry, ...]) -> None:
        """A session on another connection, of a client that holds ``inventory``."""
        self.mirror = Mirror(self.library, threads=1)
        if inventory:
            self.mirror.resume(inventory)
        self.sent = {(tile.frame, tile.tile): (1 << tile.lods) - 1 for tile in inventory}
        self.ended = -1

    def send(self, message: TileLayers | FrameEnd, payload: bytes) -> None:
        self.client.wire.append((message, payload))
        self.mirror.sent(message, payload)

    def send_layers(self, first: int, last: int) -> None:
        """Some layers of tiles of frames ``first`` to ``last``, as many as a moment allows."""
        reader = self.library.reader
        keys = [(frame, tile.tile) for frame in range(first, last + 1) for tile in reader.frame(frame).tiles]
        for at in self.rng.permutation(len(keys))[: self.rng.integers(0, 6)]:
            self._send_some(keys[at])

    def _send_some(self, key: Key) -> None:
        entry = self.library.reader.frame(key[0]).tiles[key[1]]
        lods = len(entry.lod_bytes)
        cuts = sorted({0, lods, *self.rng.integers(0, lods + 1, 2).tolist()})
        runs = list(pairwise(cuts))
        if not self.library.decoded.layered:
            lod = int(self.rng.integers(0, lods))
            runs = [(lod, lod + 1)]
        for index in self.rng.permutation(len(runs))[: self.rng.integers(1, len(runs) + 1)]:
            begin, end = runs[index]
            held = self.sent.get(key, 0)
            if held >> begin & 1 and self.rng.random() < 0.9:  # mostly nothing twice
                continue
            self.sent[key] = held | ((1 << end) - 1) & ~((1 << begin) - 1)
            parts = [self.library.reader.payload(*key, lod) for lod in range(begin, end)]
            message = TileLayers(*key, begin, end, entry.lod_bytes[begin:end])
            self.send(message, b"".join(parts))

    def send_ends(self, last: int) -> None:
        """The ends of frames up to ``last`` that have not ended; some remove ids that the bundle says nothing of."""
        start = self.library.gof_start(last) if self.ended < 0 else self.ended + 1
        for frame in range(start, last + 1):
            ids = self.library.reader.removed_ids(frame)
            if self.rng.random() < 0.2:
                capacity = self.library.manifest.capacity[self.library.manifest.gof_of(frame)]
                ids = np.union1d(ids, self.rng.integers(0, capacity, 2)).astype(np.int32)
            self.send(FrameEnd(frame), encode_ids(ids))
        self.ended = max(self.ended, last)

    def mark(self, *, restart: bool = False) -> int:
        number = self.mirror.mark()
        self.client.wire.append((Marked(number, restart), b""))
        return number

    def reference(self, frame: int) -> Referenced:
        """Mark, and draw what the client holds of it then."""
        basis = self.mark()
        if self.rng.random() < 0.5:  # what is written while a job runs is of later marks
            self.send_layers(frame, min(frame + 2, self.library.manifest.frames - 1))
        scene = self.mirror.scene_at(frame, basis)
        splats = None
        if scene is not None:
            assert self.mirror.splats is not None
            splats = copied(self.mirror.splats)
            assert isinstance(scene, KeptScene)
            assert_same(scene.splats, splats, "the renderer's own")
        made = Referenced(frame, basis, splats)
        self.client.wire.append((made, b""))
        return made

    def restart(self, frame: int) -> None:
        """The client has jumped to ``frame`` and forgotten everything."""
        self.mirror.restart(frame)
        self.sent.clear()
        self.ended = -1
        self.mark(restart=True)


def copied(splats: Splats) -> Splats:
    """Arrays of their own."""
    return Splats(**{name: array.copy() for name, array in splats.arrays()})


def assert_same(one: Splats, other: Splats, what: str = "") -> None:
    """Bit for bit, but for rows without a splat, which are absent in both."""
    absent = one.logit_opacities <= ABSENT_LOGIT
    np.testing.assert_array_equal(absent, other.logit_opacities <= ABSENT_LOGIT, what)
    rows = np.flatnonzero(~absent)
    for (name, mine), (_, theirs) in zip(one.take(rows).arrays(), other.take(rows).arrays(), strict=True):
        assert mine.tobytes() == theirs.tobytes(), f"{what}: {name} of rows {rows[differing(mine, theirs)].tolist()}"


def differing(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Rows that are not the same."""
    return np.flatnonzero((one != other).reshape(len(one), -1).any(axis=1))


@dataclass
class Session:
    """One client and its server, step by random step; at every reference both must show the same."""

    library: SceneLibrary
    rng: np.random.Generator
    client: Client = field(init=False)
    sender: Sender = field(init=False)
    planned: int = 0
    compared: int = 0
    """References at which something was shown."""

    def __post_init__(self) -> None:
        self.client = Client(self.library.reader, self.rng)
        self.sender = Sender(self.library, self.rng, self.client)

    def step(self) -> None:
        """Something happens."""
        last = self.library.manifest.frames - 1
        choice = self.rng.random()
        if choice < 0.28:
            self.sender.send_layers(
                max(self.planned - 2, self.library.gof_start(self.planned)), min(self.planned + 2, last)
            )
        elif choice < 0.34:
            self.sender.send_ends(self.planned)
        elif choice < 0.54:
            self._plan(last)
        elif choice < 0.72:
            travelling = len(self.client.wire)
            self.client.read(travelling if self.rng.random() < 0.5 else int(self.rng.integers(0, travelling + 1)))
        elif choice < 0.93:
            self._show()
        elif choice < 0.965:
            self._jump()
        elif choice < 0.98:
            self._reconnect()
        else:
            self.sender.mark()  # of a job that came to nothing

    def finish(self) -> None:
        """Show what was sent."""
        self.client.read(len(self.client.wire))
        while self.client.references:
            self._show()

    def _plan(self, last: int) -> None:
        """The next frame, or one that is further; mostly it ends before its reference is begun."""
        if self.rng.random() < 0.7:
            self.sender.send_ends(self.planned)
        self.sender.reference(self.planned)
        self.planned = min(self.planned + int(self.rng.integers(0, 3)), last)

    def _show(self) -> None:
        """The frame of the next reference, or one before it; or any where there is none."""
        client = self.client
        client.references = [made for made in client.references if made.frame >= client.shown]
        following = client.references[0] if client.references else None
        if following is None:
            if self.rng.random() < 0.1 and not client.waits:
                client.show(client.shown, None)
            return
        if self.rng.random() < 0.4:  # on the way there
            client.show(int(self.rng.integers(client.shown, following.frame + 1)), following.basis)
            return
        client.references.pop(0)
        client.show(following.frame, following.basis)
        store = client.store.on_display
        assert store is not None
        if following.basis < client.exact_from:
            return
        if following.splats is None:
            assert not store.begun or store not in client.store._stores(), "the client shows what the mirror lacks"
        else:
            self.compared += 1
            assert_same(store.splats, following.splats, f"frame {following.frame}, mark {following.basis}")

    def _jump(self) -> None:
        """Within what is kept, forgetting nothing; or anywhere, forgetting everything."""
        manifest, client = self.library.manifest, self.client
        frame = int(self.rng.integers(0, manifest.frames))
        if self.rng.random() < (0.4 if manifest.kept_whole else 0.7):
            frame = int(self.rng.integers(self.library.gof_start(client.shown), client.shown + 1))
        keeps = frame in client.store.kept and not client.waits
        keeps &= manifest.kept_whole or manifest.gof_of(self.planned) == manifest.gof_of(frame)
        client.jump(frame, keeps=keeps)
        client.wire = [item for item in client.wire if not isinstance(item[0], Referenced)]  # of another pass
        if not keeps:
            self.sender.restart(frame)
        self.planned, self.sender.ended = frame, -1

    def _reconnect(self) -> None:
        """Some of what travels is lost, and of what the client holds it says some."""
        client, layered = self.client, self.library.decoded.layered
        client.read(int(self.rng.integers(0, len(client.wire) + 1)))
        if client.waits:
            return
        said = []
        for tile in client.store.held():
            lods = tile.lods if self.rng.random() < 0.8 or not layered else int(self.rng.integers(0, tile.lods + 1))
            if lods and self.rng.random() < 0.95:
                said.append(InventoryEntry(tile.frame, tile.tile, lods))
        client.reconnect(said)
        self.sender.connect(tuple(said))
        self.planned = max(self.planned, client.shown)
