// A rubber duck, in millimetres, that looks along x and stands on z = 0.
SetFactory("OpenCASCADE");

// Body: an ellipsoid 104 long, 72 wide and 60 high.
Sphere(1) = {0, 0, 0, 1};
Dilate {{0, 0, 0}, {52, 36, 30}} { Volume{1}; }
Translate {0, 0, 26} { Volume{1}; }

// Head.
Sphere(2) = {30, 0, 68, 25};

// Beak: a flat ellipsoid.
Sphere(3) = {0, 0, 0, 1};
Dilate {{0, 0, 0}, {16, 12, 5}} { Volume{3}; }
Translate {56, 0, 64} { Volume{3}; }

// Tail: a cone that points up and back, with a round tip.
Cone(4) = {-26, 0, 30, -40, 0, 24, 22, 5};
Sphere(5) = {-66, 0, 54, 5.6};

// All in one piece, and a flat bottom to stand on.
Box(6) = {-100, -100, -100, 200, 200, 100};
BooleanUnion(7) = { Volume{1}; Delete; }{ Volume{2:5}; Delete; };
BooleanDifference(8) = { Volume{7}; Delete; }{ Volume{6}; Delete; };

Physical Volume("duck") = {8};
