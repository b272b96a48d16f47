"""What every other room runs on: read-only arrays, signs of life, tasks in one process or many, signals held back."""

# what other rooms and users import; the other modules are this room's own
__all__ = ["arrays", "executors", "progress", "settings", "signals"]
