// Upper half of the section of an O-ring, 5 mm thick, whose middle is 30 mm from the axis y.
SetFactory("OpenCASCADE");
r = 2.5; R = 30;
Point(1) = {R, 0, 0};
angles[] = {0, 45, 76, 104, 180};
For i In {0:4}
  Point(2 + i) = {R + r*Cos(angles[i]*Pi/180), r*Sin(angles[i]*Pi/180), 0};
EndFor
For i In {0:3}
  Circle(1 + i) = {2 + i, 1, 3 + i};
EndFor
Line(5) = {6, 2};
Curve Loop(1) = {1:5};
Plane Surface(1) = {1};
Physical Surface("ring") = {1};
Physical Curve("skin") = {1:4};
Physical Curve("dry") = {2};
Physical Curve("wet") = {3, 4};
Physical Curve("top") = {2, 3};
Physical Curve("middle") = {5};
