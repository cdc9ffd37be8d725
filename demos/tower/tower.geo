// A mast of spun concrete, in metres: hollow, tapered, its topmost metre the head that carries the antennas.
// z upwards, the foot at z = 0; the wind blows along x, against the surface "windward".

height = 40;  head = 1;
foot = 0.5;  tip = 0.225;                      // outer radii
wall = 0.1;
n = 30;                                        // elements along the shaft; 8 around, one through the wall

For i In {0 : 2}                               // the foot, below the head, the tip
  z = (i == 0) ? 0 : (i == 1) ? height - head : height;
  r = foot + (tip - foot) * z / height;
  Point(10 * i + 1) = {0, r - wall, z};
  Point(10 * i + 2) = {0, r, z};
  Line(10 * i + 1) = {10 * i + 1, 10 * i + 2};
EndFor
For i In {0 : 1}
  Line(10 * i + 3) = {10 * i + 1, 10 * i + 11};
  Line(10 * i + 4) = {10 * i + 2, 10 * i + 12};
  Curve Loop(i + 1) = {10 * i + 1, 10 * i + 4, -(10 * i + 11), -(10 * i + 3)};
  Plane Surface(i + 1) = {i + 1};
EndFor
Transfinite Curve {1, 11, 21} = 2;
Transfinite Curve {3, 4} = n + 1;
Transfinite Curve {13, 14} = 2;
Transfinite Surface {1, 2};

// Four quarters of a turn, the first two through -x.
For i In {1 : 2}
  profile = i;
  For k In {1 : 4}
    a() = Extrude { {0, 0, 1}, {0, 0, 0}, Pi / 2 } { Surface{profile}; Layers{2}; };
    profile = a(0);
    If (i == 1)
      base() += a(2);  shaft() += a(1);
    Else
      top() += a(1);
    EndIf
    If (k < 3)
      wind() += a(3);
    EndIf
  EndFor
EndFor
Physical Surface("base") = base();
Physical Surface("windward") = wind();
Physical Volume("shaft") = shaft();
Physical Volume("head") = top();
