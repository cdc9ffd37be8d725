// A block that sticks, a block that slides and a ball that rolls, side by side on a slope of 20 degrees.
SetFactory("OpenCASCADE");
slope = 20*Pi/180;
Box(1) = {0, 20, 0, 20, 20, 12};
Box(2) = {0, -10, 0, 20, 20, 12};
Sphere(3) = {10, -40, 10, 10};
Rotate {{0, 1, 0}, {0, 0, 0}, slope} {Volume{1:3};}
Physical Volume("sticker") = {1};
Physical Volume("slider") = {2};
Physical Volume("roller") = {3};
Physical Surface("rough") = Boundary{Volume{1};};
Physical Surface("smooth") = Boundary{Volume{2};};
Physical Surface("round") = Boundary{Volume{3};};
