// A rubber duck, in millimetres, that looks along x and stands on z = 0.
SetFactory("OpenCASCADE");

// Balls are turned so that their poles lie left and right: no other part cuts their seams.
// Body: an ellipsoid 104 long, 72 wide and 60 high, its middle at z = 26.
Sphere(1) = {0, 0, 0, 1};
Rotate {{1, 0, 0}, {0, 0, 0}, Pi/2} { Volume{1}; }
Rotate {{0, 1, 0}, {0, 0, 0}, -100*Pi/180} { Volume{1}; }
Dilate {{0, 0, 0}, {52, 36, 30}} { Volume{1}; }
Translate {0, 0, 26} { Volume{1}; }

// Head, and a beak.
Sphere(2) = {30, 0, 68, 25};
Rotate {{1, 0, 0}, {30, 0, 68}, Pi/2} { Volume{2}; }
Rotate {{0, 1, 0}, {30, 0, 68}, -Pi} { Volume{2}; }
Sphere(3) = {0, 0, 0, 1};
Rotate {{0, 1, 0}, {0, 0, 0}, -Pi/2} { Volume{3}; }
Dilate {{0, 0, 0}, {17, 14, 8}} { Volume{3}; }
Translate {53, 0, 61} { Volume{3}; }

// Tail: a cone that points up and back.
Cone(4) = {-28, 0, 28, -34, 0, 29, 24, 8};

// Eyes: caps of smaller balls.
Sphere(5) = {43.5, 9.5, 80, 6};
Rotate {{0, 0, 1}, {43.5, 9.5, 80}, -145*Pi/180} { Volume{5}; }
Sphere(6) = {43.5, -9.5, 80, 6};
Rotate {{0, 0, 1}, {43.5, -9.5, 80}, 145*Pi/180} { Volume{6}; }

// All in one piece, and a flat bottom to stand on.
BooleanUnion(10) = { Volume{1}; Delete; }{ Volume{2:6}; Delete; };
Box(20) = {-100, -100, -100, 200, 200, 100};
BooleanDifference(30) = { Volume{10}; Delete; }{ Volume{20}; Delete; };

// Rounded: neck, base of the tail, its tip, beak.
Fillet {30} {6, 4, 8, 13} {10, 8, 7.5, 4}
