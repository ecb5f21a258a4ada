"""Damaging files: bits, lengths, pieces and words, also inside of archives, whose checksums are then made right again.

A checksum rejects nearly all damage before a reader sees it, but an attacker or a broken program writes right ones.
"""

from __future__ import annotations

import gzip
import io
import random
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable, Sequence

#: Integers at which readers go wrong.
EDGES = (0, 1, 2, 7, 8, 127, 128, 255, 256, 4096, 32767, 65535, 1 << 20, 1 << 24, 1 << 28, (1 << 31) - 1, 1 << 31)
EDGES = (*EDGES, (1 << 32) - 1, 1 << 40, (1 << 63) - 1, 1 << 63, (1 << 64) - 1)

#: Words of all formats, of paths, and numbers that are none.
WORDS = (
    *(b"density", b"velocity", b"obstacle", b"flags", b"x", b"Tree_float_5_4_3", b"Tree_vec3d_5_4_3_HalfFloat"),
    *(b"ScaleTranslateMap", b"AffineMap", b"UniformScaleMap", b"MNT1", b"MNT2", b"MNT3", b"VOL\x03", b"'descr'"),
    *(b"'shape': (1, 1, 999999999)", b"fortran_order", b"|O", b"<f8", b"<f2", b"<c16", b"IDAT", b"IHDR", b"PLTE"),
    *(b"style = ", b"[", b"]" * 40, b"[" * 2000, b"{", b'"', b"'''", b"\n", b"#", b"=", b"1e400", b"9" * 5000),
    *(b"nan", b"-inf", b"\0", b"\x1b[31m", b"\xff\xfe", b"\xc3", b"A" * 6000, b"/" + b"d/" * 3000, b"../" * 200),
    *(struct.pack("<f", float("nan")), struct.pack("<f", float("inf")), struct.pack("<d", 1e308)),
)

_LONGEST = 1 << 20


def mutated(data: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    """A damaged copy of a file.

    Args:
        data: the file.
        others: files of the same format, of which parts are put into it.
        rng: decides what is done.
    """
    for unpack, change in _ENVELOPES:
        if data.startswith(unpack) and rng.random() < 0.6:
            try:
                return change(data, others, rng)
            except Exception:
                break  # the archive is damaged already: damage its bytes
    return _damaged(data, others, rng)


def _damaged(data: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    content = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 5))):
        rng.choice(_CHANGES)(content, others, rng)
    return bytes(content[:_LONGEST])


def _place(content: bytearray, rng: random.Random) -> int:
    """A place in a file: half of all are in its first bytes, where headers are."""
    end = len(content) if rng.random() < 0.5 else min(len(content), rng.choice((16, 64, 256, 1024)))
    return rng.randrange(end + 1)


def _flip(content: bytearray, others: Sequence[bytes], rng: random.Random) -> None:
    for _ in range(rng.choice((1, 1, 2, 8))):
        place = _place(content, rng)
        if place < len(content):
            content[place] ^= 1 << rng.randrange(8)


def _overwrite(content: bytearray, others: Sequence[bytes], rng: random.Random) -> None:
    place = _place(content, rng)
    content[place : place + 1] = rng.randbytes(1)


def _number(content: bytearray, others: Sequence[bytes], rng: random.Random) -> None:
    """Put an integer at an edge of its range over another one, or change one by a little."""
    place, size = _place(content, rng), rng.choice((1, 2, 4, 8))
    order = rng.choice(("little", "big"))
    if rng.random() < 0.4:
        value = int.from_bytes(content[place : place + size], order) + rng.choice((-8, -1, 1, 8))
    else:
        value = rng.choice(EDGES)
    content[place : place + size] = (value % (1 << 8 * size)).to_bytes(size, order)


def _truncate(content: bytearray, others: Sequence[bytes], rng: random.Random) -> None:
    del content[_place(content, rng) :]


def _delete(content: bytearray, others: Sequence[bytes], rng: random.Random) -> None:
    place = _place(content, rng)
    del content[place : place + rng.choice((1, 4, 16, 256))]


def _repeat(content: bytearray, others: Sequence[bytes], rng: random.Random) -> None:
    place, length = _place(content, rng), rng.choice((1, 4, 16, 256))
    content[place:place] = content[place : place + length] * rng.choice((1, 2, 20))


def _swap(content: bytearray, others: Sequence[bytes], rng: random.Random) -> None:
    """Exchange two pieces."""
    length = rng.choice((1, 4, 16, 64, 256))
    first, second = sorted((_place(content, rng), _place(content, rng)))
    if first + length <= second:
        one, two = content[first : first + length], content[second : second + length]
        content[first : first + length], content[second : second + len(two)] = two, one


def _word(content: bytearray, others: Sequence[bytes], rng: random.Random) -> None:
    place, word = _place(content, rng), rng.choice(WORDS)
    content[place : place + rng.choice((0, len(word)))] = word


def _splice(content: bytearray, others: Sequence[bytes], rng: random.Random) -> None:
    """Put a piece of another file, or its whole rest, over this one."""
    other = rng.choice(others)
    place, start = _place(content, rng), rng.randrange(len(other) + 1)
    length = rng.choice((4, 64, 1024, len(other)))
    content[place : place + length] = other[start : start + length]


_CHANGES = (_flip, _overwrite, _number, _number, _truncate, _delete, _repeat, _swap, _word, _splice)


def _inside_gzip(data: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    return gzip.compress(_damaged(gzip.decompress(data), [gzip.decompress(other) for other in others], rng), 1, mtime=0)


def _inside_zip(data: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    """Damage one member, or its name, method or claimed size."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(member, archive.read(member)) for member in archive.infolist()]
    chosen, written = rng.randrange(len(members)), io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(written, "w") as archive:
        warnings.simplefilter("ignore", UserWarning)  # members of one name
        for index, (member, content) in enumerate(members):
            name, method = member.filename, member.compress_type
            if index == chosen:
                content = _damaged(content, [content for _, content in members], rng)
                if rng.random() < 0.2:
                    name = rng.choice((members[0][0].filename, name + "\x1b[31m", "n" * 5000 + ".npy", "../" + name))
                if rng.random() < 0.2:
                    method = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA))
            archive.writestr(zipfile.ZipInfo(name), content, method)
    content = bytearray(written.getvalue())
    if rng.random() < 0.2:  # the directory, at the end, is not covered by checksums
        place = content.rfind(b"PK\1\2") + rng.choice((8, 10, 20, 24, 28, 42))
        content[place : place + 4] = struct.pack("<I", rng.choice(EDGES) % (1 << 32))
    return bytes(content)


def _inside_png(data: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    """Damage one chunk, or the pixels before compression."""
    content, place = bytearray(data[:8]), 8
    chunks: list[tuple[bytes, bytes]] = []
    while place + 8 <= len(data):
        length, kind = struct.unpack(">I4s", data[place : place + 8])
        chunks.append((kind, data[place + 8 : place + 8 + length]))
        place += 12 + length
    chosen = rng.randrange(len(chunks))
    for index, (kind, body) in enumerate(chunks):
        if index == chosen:
            pixels = kind == b"IDAT" and rng.random() < 0.5
            body = zlib.decompress(body) if pixels else body
            body = _damaged(body, [body for _, body in chunks], rng)
            body = zlib.compress(body) if pixels else body
        content += struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
    return bytes(content)


_ENVELOPES: tuple[tuple[bytes, Callable[[bytes, Sequence[bytes], random.Random], bytes]], ...] = (
    (b"\x1f\x8b", _inside_gzip),
    (b"PK\3\4", _inside_zip),
    (b"\x89PNG\r\n\x1a\n", _inside_png),
)
