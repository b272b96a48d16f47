"""Files spoilt by chance: bytes as disks and copies spoil them, values as hands and other programs do."""

from __future__ import annotations

import copy
import io
import json
import re
import zipfile

import numpy as np

NASTY = [
    None, True, False, 0, -1, 1, 3, 10**6, 2**62, -(2**63), 1e308, -1e308, 1e-320, 0.5, -0.0, 10**30, "", "x", "FA1",
    "1.5", "nan", "inf", "../a", "/etc/passwd", "a\0b", "\x1b[2J", "\u202e", "=1+1", "<script>alert(1)</script>",
    "x" * 5000, [], {}, [[]], [None], [1, "a"], {"a": 1}, [1.0, 2.0], [[1.0, 2.0], [3.0]], "2019-06-03T00:00Z",
    "0001-01-01", "9999-12-31",
]
TEXT = ["NaN", "Infinity", "-Infinity", "1e999", "9" * 40, "[" * 80 + "]" * 80, '"\\ud800"', "\ufeff", "{", '"']
CELLS = ["", "nan", "inf", "-1", "1e308", "1e999", "x", "2019-06-03T00:00Z", "0001-01-01", "9999-12-31T23:59:59Z",
         "\x00", '"', "=1+1", "9" * 40, "0", "True", "2019-02-30", "1,2", "'", "\x1b[31m"]


def spoilt_bytes(whole: bytes, rng: np.random.Generator) -> bytes:
    content = bytearray(whole)
    if not content:
        return bytes(rng.integers(256, size=10, dtype=np.uint8))
    kind = rng.integers(5)
    if kind == 0:
        del content[rng.integers(len(content)):]
    elif kind == 1:
        first, length = rng.integers(len(content)), rng.integers(1, 300)
        content[first : first + length] = b"" if rng.random() < 0.5 else bytes(length)
    elif kind == 2:
        first, second, length = rng.integers(len(content)), rng.integers(len(content)), rng.integers(1, 200)
        content[second:second] = content[first : first + length]
    else:
        reach = len(content) if kind == 3 else min(len(content), 3000)
        for place in rng.integers(reach, size=rng.integers(1, 12)):
            content[place] = rng.choice([0, 255, 127, 128, int(rng.integers(256))])
    return bytes(content)


def spoilt_json(whole: bytes, rng: np.random.Generator) -> bytes:
    if rng.random() < 0.15:
        return spoilt_bytes(whole, rng)
    text = whole.decode()
    if rng.random() < 0.15:
        numbers = list(re.finditer(r"-?\d+\.?\d*(e[+-]?\d+)?", text))
        found = numbers[rng.integers(len(numbers))]
        return (text[: found.start()] + str(rng.choice(TEXT)) + text[found.end():]).encode("utf-8", "surrogatepass")
    content = json.loads(text)
    for _ in range(rng.integers(1, 4)):
        content = _spoilt(content, rng)
    return json.dumps(content).encode()


def _spoilt(content, rng):
    """One value somewhere in tables of lists of tables changed, taken out, doubled or renamed."""
    holder, depth = content, 0
    while True:
        places = list(holder) if isinstance(holder, dict) else (
            list(range(len(holder))) if isinstance(holder, list) else [])
        if not places:
            return _nasty(rng) if holder is content else content
        place = places[rng.integers(len(places))]
        inner = holder[place]
        if isinstance(inner, dict | list) and inner and rng.random() < 0.8 and depth < 12:
            holder, depth = inner, depth + 1
            continue
        kind = rng.integers(6)
        if kind == 0:
            del holder[place]
        elif kind == 1 and isinstance(holder, list):
            holder.insert(place, inner)
        elif kind == 2 and isinstance(holder, dict):
            holder[place + "x"] = holder.pop(place)
        elif kind == 3 and isinstance(inner, int | float) and not isinstance(inner, bool):
            value = float(inner) * float(rng.choice([-1, 1e6, 1e-6, 1e300, 2])) if abs(inner) < 1e300 else 1e308
            holder[place] = value if np.isfinite(value) else 1e308
        else:
            holder[place] = _nasty(rng)
        return content


def _nasty(rng):
    return copy.deepcopy(NASTY[rng.integers(len(NASTY))])


def spoilt_lines(whole: bytes, rng: np.random.Generator) -> bytes:
    """TOML, CSV and fixed text: a word, a line or bytes."""
    if rng.random() < 0.2:
        return spoilt_bytes(whole, rng)
    lines = whole.decode("utf-8", "replace").split("\n")
    for _ in range(rng.integers(1, 4)):
        k = int(rng.integers(len(lines)))
        kind = rng.integers(6)
        if kind == 0:
            del lines[k]
        elif kind == 1:
            lines.insert(k, lines[rng.integers(len(lines))] if lines else "")
        elif kind == 2 and "=" in lines[k]:
            value = _nasty(rng)
            lines[k] = f"{lines[k].split('=')[0]}= {json.dumps(value) if value is not None else 'nan'}"
        else:
            words = re.split(r"([,\s=\[\]\"]+)", lines[k])
            words[rng.integers(len(words))] = str(rng.choice(CELLS))
            lines[k] = "".join(words)
        lines = lines or [""]
    return "\n".join(lines).encode("utf-8", "surrogatepass")


def spoilt_npz(whole: bytes, rng: np.random.Generator) -> bytes:
    if rng.random() < 0.3:
        return spoilt_bytes(whole, rng)
    with np.load(io.BytesIO(whole)) as archive:
        content = dict(archive)
    key = list(content)[rng.integers(len(content))]
    if rng.random() < 0.15:
        del content[key]
    elif content[key].dtype == np.uint8 and key == "head":
        content[key] = np.frombuffer(spoilt_json(content[key].tobytes(), rng), np.uint8)
    else:
        content[key] = _spoilt_array(content[key], rng)
    stream = io.BytesIO()
    np.savez(stream, **content)
    if rng.random() < 0.1:
        with zipfile.ZipFile(stream, "a") as archive, archive.open("big.npy", "w") as member:
            np.lib.format.write_array_header_1_0(member, {"descr": "<f8", "fortran_order": False, "shape": (10**11,)})
    return stream.getvalue()


def _spoilt_array(array: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    kind = rng.integers(8)
    if kind == 0:
        return array.ravel()
    if kind == 1:
        return array[:-1] if array.ndim and len(array) else array[None]
    if kind == 2:
        return array.astype(str)
    if kind == 3 and array.dtype.kind in "iuf":
        with np.errstate(all="ignore"):
            return array.astype(rng.choice([np.int8, np.uint64, np.float16, np.float64, np.complex128]))
    if kind == 4:
        return np.zeros((0, *array.shape[1:]), array.dtype)
    if kind == 5:
        return array[..., None]
    array = array.copy()
    if array.size and array.dtype.kind in "iufc":
        flat = array.reshape(-1)
        for k in rng.integers(array.size, size=rng.integers(1, 4)):
            value = rng.choice([0, -1, 1, 99, 2**31 - 1, -(2**31), 1e300, np.nan, np.inf])
            with np.errstate(all="ignore"):
                if array.dtype.kind in "iu":
                    low, high = np.iinfo(array.dtype).min, np.iinfo(array.dtype).max
                    # whole numbers: a float of the highest is beyond it
                    value = min(max(int(np.clip(np.nan_to_num(value), -(2.0**62), 2.0**62)), low), high)
                flat[k] = value
    return array


def spoilt_hdf5(whole: bytes, rng: np.random.Generator) -> bytes:
    """Bytes in two of three; else a dataset or attribute of another kind."""
    import h5py

    if rng.random() < 0.66:
        return spoilt_bytes(whole, rng)
    stream = io.BytesIO(whole)
    with h5py.File(stream, "r+") as file:
        names: list[str] = []
        file.visit(names.append)
        name = names[rng.integers(len(names))]
        item, kind = file[name], rng.integers(5)
        if kind == 0:
            del file[name]
        elif kind == 1 and len(item.attrs):
            key = list(item.attrs)[rng.integers(len(item.attrs))]
            value = _nasty(rng)
            if isinstance(value, str | int | float) and not isinstance(value, bool) and abs(
                    value if isinstance(value, int) else 0) < 2**63 and "\0" not in str(value):
                item.attrs[key] = value
            else:
                del item.attrs[key]
        elif isinstance(item, h5py.Dataset) and item.dtype.kind in "iufc" and not item.is_scale:
            array, attributes = _spoilt_array(item[()], rng), dict(item.attrs)
            del file[name]
            file[name] = array.astype("S") if array.dtype.kind == "U" else array
            for key, value in attributes.items():
                if key not in ("DIMENSION_LIST", "REFERENCE_LIST"):
                    file[name].attrs[key] = value
        else:
            file[f"{name}_"] = h5py.ExternalLink("/etc/passwd", "/")
    return stream.getvalue()


BY_SUFFIX = {".json": spoilt_json, ".toml": spoilt_lines, ".csv": spoilt_lines, ".dat": spoilt_lines,
             ".txt": spoilt_lines, ".uff": spoilt_lines, ".npz": spoilt_npz, ".h5": spoilt_hdf5, ".nc": spoilt_hdf5}


def spoilt(name: str, whole: bytes, rng: np.random.Generator) -> bytes:
    """A file's content spoilt as its kind is."""
    mutate = next((m for ending, m in BY_SUFFIX.items() if name.endswith(ending)), spoilt_bytes)
    return mutate(whole, rng)
