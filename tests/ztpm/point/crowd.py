"""Stranger with many half-open connections: `python -m tests.ztpm.point.crowd HOST PORT ADDRESS COUNT SECONDS`.

Each says half a request and no more; one that the server closes is opened again.
"""

import asyncio
import json
import sys

HALF = b"POST / HTTP/1.1\r\nhost: x\r\ncontent-le"


async def crowd(host, port, address, count, seconds):
    """Connections that were opened until the time was over."""
    opened = 0

    async def one():
        nonlocal opened
        while True:
            try:
                reader, writer = await asyncio.open_connection(host, port, local_addr=(address, 0))
                opened += 1
                writer.write(HALF)
                await reader.read()
                writer.close()
            except OSError:
                await asyncio.sleep(0.01)

    tasks = [asyncio.create_task(one()) for _ in range(count)]
    while opened < count:
        await asyncio.sleep(0.01)
    print(json.dumps({"crowded": True}), flush=True)
    await asyncio.sleep(seconds)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    return opened


if __name__ == "__main__":
    host, port, address, count, seconds = sys.argv[1:]
    print(json.dumps({"opened": asyncio.run(crowd(host, int(port), address, int(count), float(seconds)))}))
