// A cylinder of radius 10 and length 10 along z, in mm; curved cells follow its round side.
SetFactory("OpenCASCADE");
Cylinder(1) = {0, 0, 0, 0, 0, 10, 10};
Mesh.ElementOrder = 2;
