"""The web client reads, writes and refuses the messages that Python does."""

from __future__ import annotations

import dataclasses
import json
import random
from pathlib import Path
from typing import Any

from cags_common.errors import ProtocolError
from cags_protocol.wire.encoding import DamagedError, VersionError, decode
from cags_protocol.wire.inventory import unpack_inventory
from support.node import run_tests
from support.wire_fuzz import fuzzed

VECTORS = Path(__file__).parents[1] / "vectors" / "wire"
HOSTILE = 2000


def test_every_message_both_ways_and_hostile_ones_refused_alike(tmp_path: Path) -> None:
    rng = random.Random(20)
    recorded = [json.loads(path.read_text()) for path in sorted(VECTORS.glob("v*.json"))]
    read = [bytes.fromhex(entry["data"]) for content in recorded for entry in content["read"]]
    refuse = [bytes.fromhex(entry["data"]) for content in recorded for entry in content["refuse"]]
    messages = [_verdict(data) for data in [*read, *refuse, *(fuzzed(rng) for _ in range(HOSTILE))]]
    refused = sum("refused" in message for message in messages)
    assert refused > HOSTILE / 4
    inventories = [rng.randbytes(rng.choice([0, 6, 7, 14, 21])) for _ in range(200)]
    run_tests("wire", tmp_path, messages=messages, inventories=[_inventory(data) for data in inventories])


def _verdict(data: bytes) -> dict[str, Any]:
    """The message that Python reads, or how it refuses it."""
    try:
        message, payload = decode(data)
    except ProtocolError as error:
        kinds = ((VersionError, "version"), (DamagedError, "damaged"), (ProtocolError, "protocol"))
        return {"data": data.hex(), "refused": next(name for kind, name in kinds if isinstance(error, kind))}
    fields = json.loads(json.dumps(dataclasses.asdict(message), default=lambda part: part.hex()))
    return {"data": data.hex(), "type": message.TAG, "fields": fields, "payload": bytes(payload).hex()}


def _inventory(data: bytes) -> dict[str, Any]:
    try:
        tiles = [dataclasses.astuple(tile) for tile in unpack_inventory(data)]
    except ProtocolError:
        return {"data": data.hex()}
    return {"data": data.hex(), "tiles": tiles}
