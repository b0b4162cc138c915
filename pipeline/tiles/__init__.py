"""A map cut into tiles: the tasks that workers do, and the order in which they are done."""
