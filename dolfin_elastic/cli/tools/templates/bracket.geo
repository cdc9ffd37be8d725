// A bracket in mm: a leg with two screw holes at x = 0, an arm along x, a fillet between them.
SetFactory("OpenCASCADE");
Box(1) = {0, 0, 0, 8, 30, 60};
Box(2) = {0, 0, 0, 60, 30, 8};
BooleanUnion(3) = { Volume{1}; Delete; }{ Volume{2}; Delete; };
edge() = Curve In BoundingBox {7.9, -0.1, 7.9, 8.1, 30.1, 8.1};
body() = Fillet {3} {edge()} {6};
Cylinder(11) = {-1, 8, 45, 10, 0, 0, 2.75};
Cylinder(12) = {-1, 22, 45, 10, 0, 0, 2.75};
BooleanDifference(13) = { Volume{body()}; Delete; }{ Volume{11, 12}; Delete; };
