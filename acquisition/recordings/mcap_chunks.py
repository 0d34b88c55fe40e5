"""What is packed in a chunk of an MCAP file, which must not become many times what the file itself takes."""

import zlib

import lz4.frame
import zstandard
from mcap.records import Chunk

MAX_CHUNK_BYTES = 64 * 2**20  # a chunk of ours has less than one
MAX_COMPRESSION_RATIO = 200  # a chunk of ours is packed to an eighth
ALWAYS_ALLOWED_BYTES = 2**20


def decompress_chunk(chunk: Chunk) -> bytes:
    """
    Raises:
        ValueError: it is damaged, packed in an unknown way, or would be far too large.
        ZstdError: it is damaged.
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
            if zstandard.frame_content_size(chunk.data) > most:  # else it would be believed, whatever the chunk says
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
