"""Messages of every version so far are read, or refused, as they were when they were written down.

A hello of a version that is not spoken any more is refused by name.
"""

import dataclasses
import json
from pathlib import Path

import pytest

from cags_common.errors import ProtocolError
from cags_protocol.wire import messages as m
from cags_protocol.wire.encoding import VersionError, decode
from cags_protocol.wire.limits import SUPPORTED_VERSIONS

FILES = sorted(Path(__file__).parent.glob("v*.json"))
CONTENTS = [json.loads(path.read_text(encoding="utf-8")) for path in FILES]
READ = [entry for content in CONTENTS for entry in content["read"]]
REFUSE = [entry for content in CONTENTS for entry in content["refuse"]]


SPOKEN = [entry for entry in READ if entry["fields"].get("version", SUPPORTED_VERSIONS[0]) in SUPPORTED_VERSIONS]
UNSPOKEN = [entry for entry in READ if entry not in SPOKEN]


@pytest.mark.parametrize("entry", SPOKEN, ids=lambda entry: entry["name"])
def test_a_recorded_message_is_read(entry):
    message, payload = decode(bytes.fromhex(entry["data"]))
    fields = json.loads(json.dumps(dataclasses.asdict(message), default=lambda b: b.hex()))
    assert entry["type"] == message.TAG
    both = fields.keys() & entry["fields"].keys()  # later versions may add fields, and no longer look at others
    assert {name: fields[name] for name in both} == {name: entry["fields"][name] for name in both}
    assert both
    assert bytes(payload).hex() == entry["payload"]


@pytest.mark.parametrize("entry", UNSPOKEN, ids=lambda entry: entry["name"])
def test_a_hello_of_an_earlier_version_is_refused_in_a_line_that_names_both(entry):
    with pytest.raises(VersionError) as error:
        decode(bytes.fromhex(entry["data"]))
    text = str(error.value)
    assert f"version = {entry['fields']['version']}" in text
    assert f"speaks {SUPPORTED_VERSIONS[0]}" in text
    assert "\n" not in text


@pytest.mark.parametrize("entry", REFUSE, ids=lambda entry: entry["name"])
def test_a_recorded_breach_is_refused(entry):
    with pytest.raises(ProtocolError):
        decode(bytes.fromhex(entry["data"]))


def test_every_message_has_been_recorded():
    assert {entry["type"] for entry in READ} == {kind.TAG for kind in (*m.CLIENT_MESSAGES, *m.SERVER_MESSAGES)}
