"""What a mesh, a CAD file or the body of a case holds: names, faces, and a picture."""
