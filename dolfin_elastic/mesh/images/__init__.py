"""Images of voxels, such as computed tomography and labels, and fields on a mesh from them."""
