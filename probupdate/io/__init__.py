"""Files of every kind: written whole or not at all, read within limits, and those of other programs line by line.

`files` for text, JSON and TOML; `hdf5_file` looks through HDF5 in another process first (`hdf5_probe`); `schema` and
`result_table` are results on disk and on screen; SubDyn, its SSI files and ElastoDyn have a module each. Universal
files hold sensors and modes and are read in `campaign`.
"""

# what other rooms and users import; the other modules are this room's own
__all__ = [
    "checksum", "elastodyn_file", "files", "fortran_text", "hdf5_file", "json_rows", "outputs", "program_matrices",
    "result_table", "schema", "ssi_file", "subdyn_file",
]
