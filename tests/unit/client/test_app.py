"""The real-time shell: whatever goes wrong while it reads ends the play, at once and by name."""

from __future__ import annotations

import asyncio

import pytest

from cags_client.app import Shell, now_us
from cags_client.player import Player
from cags_client.settings import ClientSettings
from cags_common.errors import BundleError, NetworkError
from cags_common.geometry import Pose
from cags_common.transport import MemoryTransport, memory_pair
from cags_protocol import ClientSession
from cags_protocol.encoding import encode
from cags_protocol.messages import Welcome


class Still:
    def pose_at(self, t_us: int) -> Pose:
        return Pose.identity()


async def nowhere(attempt: int) -> MemoryTransport:
    raise NetworkError("there is no other server")


def shell() -> tuple[Shell, MemoryTransport]:
    """A client's shell that has said Hello, and the server's end of its connection."""
    ours, theirs = memory_pair()
    player = Player(ClientSession(now_us=now_us()), ClientSettings(), Still(), now_us=now_us())
    return Shell(ours, player, (), None, nowhere), theirs


async def test_a_manifest_that_cannot_be_read_ends_the_play_at_once() -> None:
    client, server = shell()
    await server.send(encode(Welcome("s", 30.0, 3, False, b'{"format": "something else"}')))
    async with asyncio.timeout(5):
        await client.run()
    client.close()
    assert isinstance(client.player.error, BundleError)


async def test_a_fault_while_reading_is_raised_and_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    client, server = shell()

    def broken(data: bytes, now_us: int) -> None:
        raise RuntimeError("a fault of the program")

    monkeypatch.setattr(client.player, "receive", broken)
    await server.send(b"anything")
    with pytest.raises(RuntimeError, match="a fault of the program"):
        async with asyncio.timeout(5):
            await client.run()
    client.close()
