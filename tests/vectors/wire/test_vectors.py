"""Messages of every version so far are read, or refused, as they were when they were written down."""

import dataclasses
import json
from pathlib import Path

import pytest

from cags_common.errors import ProtocolError
from cags_protocol import messages as m
from cags_protocol.encoding import decode

FILES = sorted(Path(__file__).parent.glob("v*.json"))
CONTENTS = [json.loads(path.read_text(encoding="utf-8")) for path in FILES]
READ = [entry for content in CONTENTS for entry in content["read"]]
REFUSE = [entry for content in CONTENTS for entry in content["refuse"]]


@pytest.mark.parametrize("entry", READ, ids=lambda entry: entry["name"])
def test_a_recorded_message_is_read(entry):
    message, payload = decode(bytes.fromhex(entry["data"]))
    fields = json.loads(json.dumps(dataclasses.asdict(message), default=lambda b: b.hex()))
    assert entry["type"] == message.TAG
    assert {name: fields[name] for name in entry["fields"]} == entry["fields"]  # later versions may add fields
    assert bytes(payload).hex() == entry["payload"]


@pytest.mark.parametrize("entry", REFUSE, ids=lambda entry: entry["name"])
def test_a_recorded_breach_is_refused(entry):
    with pytest.raises(ProtocolError):
        decode(bytes.fromhex(entry["data"]))


def test_every_message_has_been_recorded():
    assert {entry["type"] for entry in READ} == {kind.TAG for kind in (*m.CLIENT_MESSAGES, *m.SERVER_MESSAGES)}
