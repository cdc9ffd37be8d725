// The elastic flag behind the cylinder of Turek & Hron (2006); its left end is an arc of it.
nx = DefineNumber[60, Name "cells along it"];
ny = DefineNumber[2, Name "cells across half of it"];
Mesh.ElementOrder = 2;

root = 0.2 + Sqrt(0.05^2 - 0.01^2);
Point(1) = {0.2, 0.2, 0};                   // centre of the cylinder
Point(2) = {root, 0.19, 0};
Point(3) = {0.25, 0.2, 0};
Point(4) = {root, 0.21, 0};
Point(5) = {0.6, 0.19, 0};
Point(6) = {0.6, 0.2, 0};                   // A
Point(7) = {0.6, 0.21, 0};

Circle(1) = {2, 1, 3};
Circle(2) = {3, 1, 4};
Line(3) = {2, 5};
Line(4) = {3, 6};
Line(5) = {4, 7};
Line(6) = {5, 6};
Line(7) = {6, 7};
Curve Loop(1) = {3, 6, -4, -1};
Curve Loop(2) = {4, 7, -5, -2};
Plane Surface(1) = {1};
Plane Surface(2) = {2};
Transfinite Curve {3, 4, 5} = nx + 1;
Transfinite Curve {1, 2, 6, 7} = ny + 1;
Transfinite Surface {1} Alternate;
Transfinite Surface {2} Alternate;

Physical Curve("cylinder") = {1, 2};
Physical Surface("flag") = {1, 2};
