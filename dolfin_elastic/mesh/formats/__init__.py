"""Readers of mesh and CAD files: each returns a `RawMesh`."""
