"""Is a .mat v5 file whole? scipy looks the type of an array's values up unchecked, and a wrong one ends the process.

The layout is that of "MAT-File Format" by MathWorks, chapter 1: after a head of 128 bytes, elements of a tag (type and
size, 4 bytes each) and their content, padded to 8 bytes; arrays hold such elements too, and may be packed (zlib).
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import BinaryIO

from probupdate.errors import InputError

HEAD, PIECE = 128, 2**20
MATRIX, PACKED = 14, 15
# classes of arrays that hold numbers, and the types their values may be stored in
NUMBER_CLASSES = range(6, 16)
NUMBER_TYPES = {1, 2, 3, 4, 5, 6, 7, 9, 12, 13}
# elements of an array before its values: flags with the class, dimensions, name
BEFORE_VALUES = 3
DEEPEST = 32


def refuse_damaged(path: Path) -> int:
    """Bytes of its content, unpacked. Raises InputError where an element does not fit the file, is of no known type or
    is packed wrongly."""
    size, total = path.stat().st_size, 0
    with path.open("rb") as file:
        order = {b"IM": "<", b"MI": ">"}.get(file.read(HEAD)[-2:])
        # older files, and what is none at all, are known by their heads
        while order and file.tell() < size:
            start = file.tell()
            kind, length, content = _tag(path, file, order)
            if kind not in (MATRIX, PACKED) or content + length > size:
                raise _damage_error(path, start)
            if kind == PACKED:
                total += _refuse_wrongly_packed(path, file, length)
            else:
                total += length
                _refuse_unknown_values(path, file, order, content + length)
            file.seek(content + length)
    return total


def _tag(path: Path, file: BinaryIO, order: str) -> tuple[int, int, int]:
    """(type, size, where the content begins) of the element at hand; small ones have all in eight bytes."""
    start = file.tell()
    raw = file.read(8)
    if len(raw) < 8:
        raise _damage_error(path, start)
    first, second = struct.unpack(order + "II", raw)
    if first >> 16:
        return first & 0xFFFF, first >> 16, start + 4
    return first, second, start + 8


def _refuse_unknown_values(path: Path, file: BinaryIO, order: str, end: int, depth: int = 0) -> None:
    number, of_numbers = 0, False
    while file.tell() < end:
        start = file.tell()
        kind, length, content = _tag(path, file, order)
        unknown = number >= BEFORE_VALUES and of_numbers and kind not in NUMBER_TYPES
        if content + length > end or unknown or (number == 0 and length < 4) or depth > DEEPEST:
            raise _damage_error(path, start)
        if number >= BEFORE_VALUES and kind == MATRIX and length:
            # fields and cells are arrays again
            file.seek(content)
            _refuse_unknown_values(path, file, order, content + length, depth + 1)
        if number == 0:
            file.seek(content)
            of_numbers = struct.unpack(order + "I", file.read(4))[0] & 0xFF in NUMBER_CLASSES
        file.seek(start + 8 if content == start + 4 else content + length + -length % 8)
        number += 1


def _refuse_wrongly_packed(path: Path, file: BinaryIO, length: int) -> int:
    """Bytes unpacked. zlib ends with a checksum of what was packed: what passes it is as it was written."""
    start, unpacked, total = file.tell(), zlib.decompressobj(), 0
    try:
        while length > 0 and not unpacked.eof:
            packed = file.read(min(length, PIECE))
            length -= len(packed)
            while packed:
                total += len(unpacked.decompress(packed, PIECE))
                packed = unpacked.unconsumed_tail
    except zlib.error:
        raise _damage_error(path, start) from None
    if not unpacked.eof:
        raise _damage_error(path, start)
    return total


def _damage_error(path: Path, at: int) -> InputError:
    return InputError(str(path), f"is damaged at byte {at}, where .mat v5 has no such content", "copy or save it again")
