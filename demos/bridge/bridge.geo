// A tied-arch bridge of steel, in metres: span 40, width 6.5, rise 8.
// x along the bridge, y across, z up; the deck's top is z = 0.
SetFactory("OpenCASCADE");

span = 40;  rise = 8;  width = 6;
rib = 0.6;                                     // side of the arch's box section
R = (span^2 / 4 + rise^2) / (2 * rise);        // radius of the arch's axis
zc = rise - R;                                 // its centre

// The deck.
Box(1) = {-span / 2 - 1, -width / 2 - rib / 2, -0.5, span + 2, width + rib, 0.5};

// The ribs: rings cut off below the deck's top.
Box(90) = {-R - 1, -width, -3 * R, 2 * R + 2, 2 * width, 3 * R - 0.25};
For side In {-1 : 1 : 2}
  k = 10 + side;
  Cylinder(k) = {0, side * width / 2 - rib / 2, zc, 0, rib, 0, R + rib / 2};
  Cylinder(20 + side) = {0, side * width / 2 - rib / 2, zc, 0, rib, 0, R - rib / 2};
  BooleanDifference(30 + side) = { Volume{k}; Delete; }{ Volume{20 + side}; Delete; };
  BooleanDifference(40 + side) = { Volume{30 + side}; Delete; }{ Volume{90}; };
EndFor
Recursive Delete { Volume{90}; }
parts() = {39, 41};

// Hangers every five metres, and struts between the ribs above them.
n = 100;
For i In {-3 : 3}
  x = 5 * i;
  top = zc + Sqrt(R^2 - x^2);
  For side In {-1 : 1 : 2}
    Box(n) = {x - 0.15, side * width / 2 - 0.15, -0.25, 0.3, 0.3, top + 0.25};
    parts() += n;  n += 1;
  EndFor
  If (i > -3 && i < 3)
    Box(n) = {x - 0.2, -width / 2, top - 0.2, 0.4, width, 0.4};
    parts() += n;  n += 1;
  EndIf
EndFor

BooleanUnion(500) = { Volume{1}; Delete; }{ Volume{parts()}; Delete; };
Physical Volume("bridge") = {500};
