"""One evidence for what a reference lets channels do: directions within a subspace, up to an error of unknown size."""

__all__ = ["directions", "gains"]
