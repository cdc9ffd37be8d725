SetFactory("OpenCASCADE");
// Two bunnies, the upper one turned round; in mm.  Each part is a ball, stretched and turned.
For b In {0:1}
  n = 20*b;
  Sphere(n + 1) = {0, 0, 0, 1};
  Dilate {{0, 0, 0}, {15, 11, 12}} { Volume{n + 1}; }
  Translate {0, 0, 13} { Volume{n + 1}; }
  Sphere(n + 2) = {12, 0, 27, 8.5};
  Sphere(n + 3) = {-4, 7, 9, 8};
  Sphere(n + 4) = {-4, -7, 9, 8};
  Sphere(n + 5) = {-15, 0, 10, 4.5};
  For i In {0:1}
    y = 1 - 2*i;
    Sphere(n + 6 + i) = {0, 0, 0, 1};
    Dilate {{0, 0, 0}, {3.2, 4.2, 11}} { Volume{n + 6 + i}; }
    Rotate {{0, 1, 0}, {0, 0, 0}, -0.5} { Volume{n + 6 + i}; }
    Translate {5, 4.6*y, 39} { Volume{n + 6 + i}; }
    Sphere(n + 8 + i) = {0, 0, 0, 1};
    Dilate {{0, 0, 0}, {7, 3.6, 3.6}} { Volume{n + 8 + i}; }
    Translate {12, 5*y, 3.6} { Volume{n + 8 + i}; }
  EndFor
  BooleanUnion(n + 10) = { Volume{n + 1}; Delete; }{ Volume{n + 2:n + 9}; Delete; };
EndFor
Rotate {{0, 0, 1}, {2, 0, 0}, Pi} { Volume{30}; }
Translate {0, 0, 2} { Volume{10}; }
Translate {0, 0, 53} { Volume{30}; }
Physical Volume("lower") = {10};
Physical Volume("upper") = {30};
Physical Surface("skin") = Boundary{Volume{10, 30};};
