"""A symmetric tangent by the half of its blocks."""
