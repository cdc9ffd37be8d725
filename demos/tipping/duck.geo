// A rubber duck, in millimetres, that looks along x and stands on z = 0.
SetFactory("OpenCASCADE");

// Body: an ellipsoid 104 long, 72 wide and 60 high, its middle at z = 26.
Sphere(1) = {0, 0, 0, 1};
Dilate {{0, 0, 0}, {52, 36, 30}} { Volume{1}; }
Translate {0, 0, 26} { Volume{1}; }

// Head with two eyes, and a flat beak.
Sphere(2) = {30, 0, 68, 25};
Sphere(3) = {47, 13, 79, 4.5};
Sphere(4) = {47, -13, 79, 4.5};
Sphere(5) = {0, 0, 0, 1};
Dilate {{0, 0, 0}, {17, 13, 5}} { Volume{5}; }
Translate {55, 0, 64} { Volume{5}; }

// Tail: a cone that points up and back, with a round tip.
Cone(6) = {-28, 0, 28, -30, 0, 26, 24, 6};
Sphere(7) = {-57, 0, 53, 7};

// All in one piece, and a flat bottom to stand on.
BooleanUnion(10) = { Volume{1}; Delete; }{ Volume{2:7}; Delete; };
Box(20) = {-100, -100, -100, 200, 200, 100};
BooleanDifference(30) = { Volume{10}; Delete; }{ Volume{20}; Delete; };
Physical Volume("duck") = {30};

// Finer elements at eyes, beak and tail; elsewhere as the case says.
Field[1] = Ball;  Field[1].VIn = 2.2;  Field[1].VOut = 100;  Field[1].Thickness = 25;
Field[1].XCenter = 48;  Field[1].YCenter = 13;  Field[1].ZCenter = 79;  Field[1].Radius = 5;
Field[2] = Ball;  Field[2].VIn = 2.2;  Field[2].VOut = 100;  Field[2].Thickness = 25;
Field[2].XCenter = 48;  Field[2].YCenter = -13;  Field[2].ZCenter = 79;  Field[2].Radius = 5;
Field[3] = Ball;  Field[3].VIn = 3;  Field[3].VOut = 100;  Field[3].Thickness = 60;
Field[3].XCenter = 62;  Field[3].YCenter = 0;  Field[3].ZCenter = 64;  Field[3].Radius = 15;
Field[4] = Ball;  Field[4].VIn = 3.5;  Field[4].VOut = 100;  Field[4].Thickness = 60;
Field[4].XCenter = -57;  Field[4].YCenter = 0;  Field[4].ZCenter = 53;  Field[4].Radius = 8;
Field[5] = Min;  Field[5].FieldsList = {1, 2, 3, 4};
Background Field = 5;
