"""Own inputs with a value, a key, a row or an array mutated: what is neither done nor refused in one line.

    python studies/faults/fuzz_inputs.py OUT SEED SECONDS      # tests/fuzz.py has the mutations; OUT/fuzz.txt
"""

import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests"))
from fuzz import fuzz


def until(end: float, tried: Counter) -> Iterator[int]:
    """Numbers of mutations, as long as there is time."""
    while time.monotonic() < end:
        tried["mutations"] += 1
        yield tried["mutations"] - 1


def main(out: Path, seed: int, seconds: float) -> None:
    out.mkdir(parents=True, exist_ok=True)
    tried: Counter = Counter()
    with tempfile.TemporaryDirectory() as folder, (out / "fuzz.txt").open("w") as file:
        for case, number, said in fuzz(Path(folder), seed, until(time.monotonic() + seconds, tried)):
            tried["neither done nor refused in one line"] += 1
            print(f"{number}: {case.arguments[0]}, {case.file.name}: {said}", file=file, flush=True)
        print(f"seed {seed}: {dict(tried)}; each that was not is a line of {out / 'fuzz.txt'}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]))
