"""Run as a program of its own: opens HDF5 files named on standard input and answers whether they are safe to read.

A damaged index can hold the HDF5 library forever, or end its process; this one may be ended. A line in: {"path",
"whole", "seconds"}; a line out: {"problem": null or words}, before it a blank after every STEP objects. `whole`: all
data are read here first. Limits on processor time (`seconds`, granted once more for every STEP
objects: a year of modal sets has many small ones) and memory (the argument, bytes) hold where the system has them.
"""

import json
import math
import sys

# a chunk is unpacked as one piece; gzip packs at most 1032-fold, so that smaller stored ones stay below 1 GiB
LARGEST_CHUNK = 256 * 2**20
SMALL_STORED = 2**20
# what a file that is read whole may declare, and how many objects any file may have
LARGEST_WHOLE = 2**30
# declared but not written numbers that are read as zeros; more would keep every step busy with nothing
LARGEST_UNWRITTEN = 2**28
MOST_OBJECTS = 500_000
STEP = 200
# what the library keeps of a file's description of its objects, bytes at least, at first and at most: by itself 32 MB,
# which unpacked are more than twice as many
DESCRIBED = (2**17, 2**18, 2**19)


def keep_little(file):
    """Bounds what the library keeps of an open file's description."""
    kept = file.id.get_mdc_config()
    kept.min_size, kept.initial_size, kept.max_size = DESCRIBED
    file.id.set_mdc_config(kept)


def file_problem(path, whole, stepped=lambda: None):
    """Words on what makes the file unsafe, or None; stepped: called after every STEP objects."""
    import h5py
    from h5py import h5l  # pyright: ignore[reportAttributeAccessIssue]  (compiled, without stubs)

    with h5py.File(path, "r") as file:
        keep_little(file)
        names, links = [], []

        def link(name, info):
            if info.type == h5l.TYPE_EXTERNAL:
                links.append(name)
            elif info.type == h5l.TYPE_HARD:
                names.append(name)
            return 1 if links or len(names) > MOST_OBJECTS else None

        file.id.links.visit(link, info=True)
        if links:
            return f"link '{_text(links[0])}' leads to another file"
        if len(names) > MOST_OBJECTS:
            return f"holds more than {MOST_OBJECTS} objects"
        total = 0
        for number, name in enumerate(names):
            if number % STEP == STEP - 1:
                stepped()
            item = file[name]
            for key in item.attrs:
                item.attrs[key]
            if not isinstance(item, h5py.Dataset):
                continue
            wrong = dataset_problem(item, complete=not whole)
            if wrong:
                return f"dataset '{_text(name)}' {wrong}"
            total += _size(item)
            if whole and total > LARGEST_WHOLE:
                return f"holds more than {LARGEST_WHOLE // 2**20} MB"
            if whole:
                item[()]
    return None


def external_storage_words(dataset):
    """Words on samples that lie in other files, or None."""
    import h5py

    created = dataset.id.get_create_plist()
    if created.get_external_count() > 0:
        return "keeps its numbers in another file"
    if created.get_layout() == h5py.h5d.VIRTUAL:
        return "is put together from other files"
    return None


def dataset_problem(dataset, complete):
    """Words on what makes a dataset unsafe, or None; complete: a large one whose numbers were never written is one."""
    import h5py

    wrong = external_storage_words(dataset)
    if wrong or dataset.shape is None or 0 in dataset.shape:
        return wrong
    complete = complete and _size(dataset) > LARGEST_UNWRITTEN
    if dataset.chunks is None:
        contiguous = dataset.id.get_create_plist().get_layout() == h5py.h5d.CONTIGUOUS
        if complete and contiguous and dataset.id.get_storage_size() < _size(dataset):
            return "declares more numbers than the file holds"
        return None
    n_byte = dataset.dtype.itemsize
    for n in dataset.chunks:
        n_byte *= int(n)
    if n_byte > LARGEST_CHUNK:
        return f"has chunks of {n_byte // 2**20} MB, more than {LARGEST_CHUNK // 2**20} MB"
    large, count = [], 0

    def stored(chunk):
        nonlocal count
        count += 1
        if chunk.size > SMALL_STORED:
            large.append((chunk.chunk_offset, chunk.size))

    dataset.id.chunk_iter(stored)
    needed = 1
    for n, c in zip(dataset.shape, dataset.chunks, strict=True):
        needed *= -(-int(n) // int(c))
    if complete and count < needed:
        return f"declares {dataset.shape[0]} samples, but holds only {count} of {needed} chunks of them"
    if dataset.id.get_create_plist().get_nfilters():
        for offset, size in large:
            if size > 2 * n_byte + 4096:
                return "has a chunk that is larger packed than unpacked"
            # unpacked here, where memory is limited
            dataset[tuple(slice(a, a + c) for a, c in zip(offset, dataset.chunks, strict=True))]
    return None


def _size(dataset):
    total = dataset.dtype.itemsize
    for n in dataset.shape or ():
        total *= int(n)
    return total


def _text(name):
    return (name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name))[:100]


def limit_memory(memory):
    """Sets the limit on memory; returns a function that grants so many seconds more of processor time."""
    try:
        import resource
    except ImportError:
        return lambda seconds: None
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (memory if most < 0 else min(memory, most), most))

    def grant(seconds):
        used = resource.getrusage(resource.RUSAGE_SELF)
        _, hard = resource.getrlimit(resource.RLIMIT_CPU)
        # limits are whole seconds, and none of those granted is lost to that
        wanted = math.ceil(used.ru_utime + used.ru_stime) + seconds
        resource.setrlimit(resource.RLIMIT_CPU, (wanted if hard < 0 else min(wanted, hard), hard))

    return grant


def answer_all():
    memory = int(sys.argv[1])
    import h5py  # noqa: F401  before the limit on memory

    grant = limit_memory(memory)
    for line in sys.stdin:
        asked = json.loads(line)
        grant(asked["seconds"])

        def stepped(seconds=asked["seconds"]):
            grant(seconds)
            sys.stdout.write(" ")
            sys.stdout.flush()

        try:
            found = file_problem(asked["path"], asked["whole"], stepped)
        except Exception as error:
            reason = str(error).strip() or "no reason given"
            found = f"{type(error).__name__}: {reason.splitlines()[0][:300]}"
        sys.stdout.write(json.dumps({"problem": found}) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    answer_all()
