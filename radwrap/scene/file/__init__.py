"""What the user writes, and how it becomes a Scene."""
