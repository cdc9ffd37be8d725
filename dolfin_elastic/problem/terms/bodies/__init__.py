"""Contact between surfaces of the mesh: two that are named, or any with themselves."""
