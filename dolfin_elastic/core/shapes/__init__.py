"""Shapes beside a body: planes, boxes, spheres and cylinders."""
