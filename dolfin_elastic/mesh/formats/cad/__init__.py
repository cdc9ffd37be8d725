"""CAD files, meshed by Gmsh."""
