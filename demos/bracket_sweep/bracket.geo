// A bracket in millimetres: a leg to screw on at x = 0, an arm along x, rounded inside.
SetFactory("OpenCASCADE");
Box(1) = {0, 0, 0, 8, 20, 50};
Box(2) = {0, 0, 0, 60, 20, 8};
BooleanUnion(3) = { Volume{1}; Delete; }{ Volume{2}; Delete; };
// The edge between them.
edge() = Curve In BoundingBox {7.9, -0.1, 7.9, 8.1, 20.1, 8.1};
Fillet {3} {edge()} {6}
