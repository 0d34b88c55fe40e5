"""The function that decompresses MCAP chunks, bounded so that a small file cannot fill the memory."""

import zlib

import lz4.frame
import zstandard
from mcap.records import Chunk

MAX_CHUNK_BYTES = 64 * 2**20  # less than 1 MiB in chunks of Graspwatch
MAX_COMPRESSION_RATIO = 200  # about 8 in chunks of Graspwatch
ALWAYS_ALLOWED_BYTES = 2**20


def decompress_chunk(chunk: Chunk) -> bytes:
    """Return the uncompressed content of a chunk of an MCAP file.

    Raises:
        ValueError: the chunk is damaged, has an unknown compression, or would be too large.
        ZstdError: the chunk is damaged.
    """
    most = min(MAX_CHUNK_BYTES, max(ALWAYS_ALLOWED_BYTES, MAX_COMPRESSION_RATIO * len(chunk.data)))
    if chunk.uncompressed_size > most:
        raise ValueError(f"{len(chunk.data)} bytes are said to become {chunk.uncompressed_size}")
    data = _decompress(chunk, most)
    if len(data) > most:
        raise ValueError(f"{len(chunk.data)} bytes become more than {most}")
    if chunk.uncompressed_crc and chunk.uncompressed_crc != zlib.crc32(data):
        raise ValueError("its check sum is another one")
    return data


def _decompress(chunk: Chunk, most: int) -> bytes:
    match chunk.compression:
        case "zstd":
            if zstandard.frame_content_size(chunk.data) > most:  # it would override the limit on the output
                raise ValueError(f"{len(chunk.data)} bytes become more than {most}")
            return zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=max(chunk.uncompressed_size, 1))
        case "lz4":
            try:
                return lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=most + 1)
            except RuntimeError as error:
                raise ValueError(str(error)) from None
        case "":
            return chunk.data
    raise ValueError(f"it is packed by {chunk.compression!r}")
