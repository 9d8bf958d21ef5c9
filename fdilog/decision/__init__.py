"""From evidence to findings, and from findings to channel status and verdict."""
