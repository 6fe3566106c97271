"""One client of the load in its own process: ``python -m cags_bench.network.load_client URL SECONDS``."""

from __future__ import annotations

import asyncio
import sys
import time

from cags_bench.network.load import Arrivals, LoadClient
from cags_bench.network.sockets import drive
from cags_common.transport.websocket import connect
from cags_protocol.wire.limits import MAX_MESSAGE_BYTES, SUBPROTOCOL


async def watch(url: str, duration_us: int) -> None:
    """Join, receive and acknowledge."""
    start_ns = time.monotonic_ns()
    transport = await connect(url, subprotocol=SUBPROTOCOL, max_message_bytes=MAX_MESSAGE_BYTES)
    await drive(LoadClient(Arrivals()), transport, lambda: (time.monotonic_ns() - start_ns) // 1000, duration_us)
    await transport.close()


if __name__ == "__main__":
    asyncio.run(watch(sys.argv[1], round(float(sys.argv[2]) * 1e6)))
