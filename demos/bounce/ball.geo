// A hollow rubber ball, in millimetres, of 60 outside and a wall of 6; its lowest point is at z = 0.
SetFactory("OpenCASCADE");
Sphere(1) = {0, 0, 30, 30};
Sphere(2) = {0, 0, 30, 24};
BooleanDifference(3) = { Volume{1}; Delete; }{ Volume{2}; Delete; };
Physical Volume("ball") = {3};
