"""Texts of the page: what is taken, and what is refused by name."""

from __future__ import annotations

import json
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_client.output.page import messages
from cags_client.output.page.messages import (
    PageHello,
    PageLook,
    PagePose,
    PageSet,
    PageShown,
    pack,
    parse,
)
from cags_common.errors import ProtocolError


def said(**fields: object) -> str:
    return json.dumps(fields)


def test_every_message_is_parsed() -> None:
    assert parse(said(type="hello", h264=True)) == PageHello(True)
    assert parse(said(type="hello", h264=True, raw=True)) == PageHello(True, True)
    assert parse(said(type="hello", h264=True, token="sesame")) == PageHello(True, False, "sesame")
    pose = parse(said(type="pose", at_us=3, position=[1, 2, 3], rotation=[-1, 0, 0, 0]))
    assert isinstance(pose, PagePose)
    assert (pose.at_us, pose.pose.position, pose.pose.rotation[0]) == (3, (1.0, 2.0, 3.0), 1.0)
    look = parse(said(type="look", pictures=["truth", "truth"], overlays=["detail"]))
    assert look == PageLook(("truth",), frozenset({"detail"}))
    assert parse(said(type="set", name="frame", value=12)) == PageSet("frame", 12.0)
    assert parse(said(type="set", name="playing", value=True)) == PageSet("playing", True)
    assert parse(said(type="set", name="cap_mbps", value=None)) == PageSet("cap_mbps", None)
    assert parse(said(type="set", name="restorer", value="none")) == PageSet("restorer", "none")
    assert parse(said(type="shown", number=9, key=False)) == PageShown(9, False)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "JSON"),
        ("[" * 5000, "JSON"),
        ("[1]", "type None"),
        (said(type="nonsense"), "'nonsense'"),
        (said(type=["hello"]), "type"),
        (said(type="hello", h264=1), "h264"),
        (said(type="hello", h264=True, raw="yes"), "raw"),
        (said(type="pose", at_us=1, position=[0, 0], rotation=[1, 0, 0, 0]), "position"),
        (said(type="pose", at_us=1, position=[0, 0, 1e300], rotation=[1, 0, 0, 0]), "position"),
        (said(type="pose", at_us=1, position=[0, 0, 0], rotation=[0, 0, 0, 0]), "quaternion"),
        (said(type="pose", at_us=-1, position=[0, 0, 0], rotation=[1, 0, 0, 0]), "at_us"),
        (said(type="window", width=0, height=9), "window of 0 x 9"),
        (said(type="window", width=9, height=32769), "window of 9 x 32769"),
        (said(type="window", width=9.5, height=9), "width"),
        (said(type="window", width=9), "height"),
        ('{"type":"pose","at_us":1,"position":[0,0,NaN],"rotation":[1,0,0,0]}', "position"),
        (said(type="look", pictures=[], overlays=[]), "pictures"),
        (said(type="look", pictures=["restored"] * 3, overlays=[]), "pictures"),
        (said(type="look", pictures=["secret"], overlays=[]), "secret"),
        (said(type="set", name="explode", value=1), "explode"),
        (said(type="set", name="frame", value="x"), "frame"),
        (said(type="set", name="playing", value=1), "playing"),
        (said(type="set", name="restorer", value=3), "restorer"),
        (said(type="set", name="delay_ms", value=True), "delay_ms"),
        (said(type="set", name="delay_ms", value=None), "delay_ms"),
        (said(type="hello", h264=True, token=5), "token"),
        (said(type="hello", h264=True, token="x" * 257), "token"),
        (said(type="hello", h264=True, token="\ud800"), "token"),
        (said(type="hello", h264=True, filler="x" * messages.MAX_TEXT_BYTES), "longer"),
    ],
)
def test_anything_off_is_refused_by_name(text: str, named: str) -> None:
    with pytest.raises(ProtocolError, match=named.replace("[", r"\[")):
        parse(text)


@given(
    st.text(max_size=200) | st.recursive(st.none() | st.booleans() | st.floats() | st.text(), st.lists).map(json.dumps)
)
def test_no_text_brings_the_parser_down(text: str) -> None:
    with pytest.raises(ProtocolError):
        parse(text)


@given(
    st.fixed_dictionaries(
        {"type": st.sampled_from(["hello", "pose", "look", "set", "shown"])},
        optional={
            name: st.none() | st.booleans() | st.floats() | st.text(max_size=9) | st.lists(st.floats(), max_size=5)
            for name in (
                "h264",
                "raw",
                "token",
                "at_us",
                "number",
                "position",
                "rotation",
                "pictures",
                "overlays",
                "name",
                "value",
            )
        },
    )
)
def test_wrong_fields_are_refused_and_right_ones_taken(fields: dict[str, object]) -> None:
    try:
        parse(json.dumps(fields))
    except ProtocolError as error:
        assert "page" in str(error)


def test_packed_frames_carry_header_and_payloads_and_no_nan() -> None:
    data = pack({"a": float("nan"), "b": [float("inf"), 1.5], "c": {"d": (2, "x")}}, [b"one", b"two"])
    (length,) = struct.unpack_from(">I", data)
    assert json.loads(data[4 : 4 + length]) == {"a": None, "b": [None, 1.5], "c": {"d": [2, "x"]}}
    assert data[4 + length :] == b"onetwo"
