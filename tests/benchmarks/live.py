"""The live service: how fast it is ready, and how it keeps time with many viewers."""

import asyncio
import os
import re
import tempfile
import time
from pathlib import Path

from service import Service
from websockets.asyncio.client import connect

from app.messages.live import FRAME_HEADER

SETTLE_S = 15.0


def measure_start() -> list[dict]:
    def ready_after() -> float:
        begin = time.perf_counter()
        with Service("serve"):
            return time.perf_counter() - begin

    with tempfile.TemporaryDirectory() as cache:
        os.environ["NUMBA_CACHE_DIR"] = cache
        first, warm = ready_after(), ready_after()
        del os.environ["NUMBA_CACHE_DIR"]
    return [
        {"name": "ready the first time", "value": first, "unit": "s", "floor": "at most 60"},
        {"name": "ready on a warm cache", "value": warm, "unit": "s", "floor": "at most 10"},
    ]


def measure(seconds: float, viewers: int) -> list[dict]:
    with Service("serve", "--demo") as service:
        begin_mb, received = asyncio.run(_watch(service, seconds, viewers))
        text = service.http.get("/metrics").text
        end_mb = _memory_mb(service)
    missing = sum(_value(text, f'graspwatch_missing_blocks{{receiver="{who}"}}') for who in ("server", "estimator"))
    estimate, acquisition = "graspwatch_estimate_latency_seconds", "graspwatch_acquisition_lateness_seconds"
    rows = [
        ("samples lost", _value(text, "graspwatch_lost_samples_total"), "", "0"),
        ("blocks lost between workers", missing, "", "0"),
        ("sample to estimate, p50 under", _percentile(text, estimate, 0.5), "ms", ""),
        ("sample to estimate, p99 under", _percentile(text, estimate, 0.99), "ms", "under 3"),
        ("acquisition lateness, p99 under", _percentile(text, acquisition, 0.99), "ms", "under 1"),
        ("samples that reached each viewer, least", min(received) / (seconds * 10), "%", "100"),
        ("memory at the beginning", begin_mb, "MB", ""),
        ("memory at the end", end_mb, "MB", "flat"),
    ]
    return [{"name": name, "value": value, "unit": unit, "floor": floor} for name, value, unit, floor in rows]


async def _watch(service: Service, seconds: float, viewers: int) -> tuple[float, list[int]]:
    begin_mb = 0.0

    async def watch() -> int:
        rows = 0
        async with connect(service.live_url, max_size=None, compression=None) as socket:
            begin = time.monotonic()
            while time.monotonic() - begin < seconds:
                message = await socket.recv()
                if isinstance(message, bytes):
                    header = FRAME_HEADER.unpack_from(message)
                    rows += header[4] if header[1] == 0 else 0
                    await socket.send(f'{{"type":"received","sequence":{header[5]}}}')
        return rows

    async def note_memory() -> int:
        nonlocal begin_mb
        await asyncio.sleep(min(SETTLE_S, seconds / 2))
        begin_mb = _memory_mb(service)
        return 0

    *received, _ = await asyncio.gather(*(watch() for _ in range(viewers)), note_memory())
    return begin_mb, received


def _memory_mb(service: Service) -> float:
    pids = [service.process.pid, service.worker("acquisition"), service.worker("estimator")]
    pages = sum(int(Path(f"/proc/{pid}/statm").read_text().split()[1]) for pid in pids)
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _value(text: str, name: str) -> float:
    found = re.search(rf"^{re.escape(name)} (\S+)$", text, re.MULTILINE)
    return float(found[1]) if found else 0.0


def _percentile(text: str, name: str, share: float) -> float:
    """Upper bound of the bucket in which the percentile lies, ms."""
    buckets = re.findall(rf'^{name}_bucket{{le="([^"]+)"}} (\S+)$', text, re.MULTILINE)
    total = float(buckets[-1][1])
    return next(float(bound) for bound, count in buckets if float(count) >= share * total) * 1e3
