"""What follows from tensors at points and from surfaces, evaluated in NumPy."""
