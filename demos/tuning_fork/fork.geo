// A tuning fork of one piece of square steel, in mm: two prongs, a round bend, a stem.
// y along the prongs, x across, z through the thickness; the bend's centre is the origin.

prong = 87.36;                 // length of a prong, from the end of the bend: what tunes it
side = 5;                   // side of the prongs' square section
gap = 8;                    // between the prongs
stem = 40;  width = 6;      // of the stem
n = 2;                      // cells across a prong
quarter = 0;                // 1: only x > 0 and z > 0, for motions that are symmetric

ri = gap / 2;  ro = ri + side;
s = width / 2;  c = Sqrt(ro^2 - s^2);         // where the stem meets the bend
low = quarter ? 0 : -side / 2;  high = side / 2;

Point(1) = {0, 0, low};
// Ends of the bend and of the prong at the right: inside, outside.
Point(2) = {ri, 0, low};                      Point(3) = {ro, 0, low};
Point(4) = {ri, prong, low};                  Point(5) = {ro, prong, low};
// Where the stem begins, on the inner and the outer arc; the same in the middle; its end.
Point(6) = {s * ri / ro, -c * ri / ro, low};  Point(7) = {s, -c, low};
Point(8) = {0, -ri, low};                     Point(9) = {0, -ro, low};
Point(10) = {s, -ro - stem, low};             Point(11) = {0, -ro - stem, low};

Line(1) = {2, 3};  Line(2) = {4, 5};  Line(3) = {6, 7};  Line(4) = {8, 9};
Line(5) = {2, 4};  Line(6) = {3, 5};
Circle(7) = {2, 1, 6};  Circle(8) = {3, 1, 7};
Circle(9) = {6, 1, 8};  Circle(10) = {7, 1, 9};
Line(11) = {7, 10};  Line(12) = {9, 11};  Line(13) = {10, 11};
Curve Loop(1) = {1, 6, -2, -5};     Plane Surface(1) = {1};     // prong
Curve Loop(2) = {1, 8, -3, -7};     Plane Surface(2) = {2};     // bend
Curve Loop(3) = {3, 10, -4, -9};    Plane Surface(3) = {3};     // above the stem
Curve Loop(4) = {11, 13, -12, -10}; Plane Surface(4) = {4};     // stem
Transfinite Curve {1, 2, 3, 4} = n + 1;
Transfinite Curve {5, 6} = 9 * n + 1;
Transfinite Curve {7, 8} = 3 * n + 1;
Transfinite Curve {9, 10, 13} = Ceil(n / 2) + 1;
Transfinite Curve {11, 12} = 4 * n + 1;
Transfinite Surface {1, 2, 3, 4};

sections() = {1, 2, 3, 4};
If (!quarter)
  Geometry.CopyMeshingMethod = 1;
  sections() += Symmetry {1, 0, 0, 0} { Duplicata { Surface{1, 2, 3, 4}; } };
  Coherence;
EndIf
made() = Extrude {0, 0, high - low} {
  Surface{sections()}; Layers{quarter ? Ceil(n / 2) : n};
};
Physical Volume("fork") = Volume{:};
Physical Surface("foot") = Surface In BoundingBox {
  -s - 0.1, -ro - stem - 0.1, low - 0.1, s + 0.1, -ro - stem + 0.1, high + 0.1
};
Mesh.ElementOrder = 2;      // round cells in the bend
