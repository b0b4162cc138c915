"""What a run will take: tiles, memory, disk."""
