"""What a body remembers of its past, where its materials do."""
