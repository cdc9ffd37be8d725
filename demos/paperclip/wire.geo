// Half the length and half the section of a wire of 1 mm: the middle is at x = 0, the plane of bending is z = 0.
SetFactory("OpenCASCADE");
Disk(1) = {0, 0, 0, 0.5};
Rectangle(2) = {-1, 0, 0, 2, 1};
BooleanIntersection(3) = { Surface{1}; Delete; }{ Surface{2}; Delete; };
Rotate {{1, 0, 0}, {0, 0, 0}, Pi/2} { Surface{3}; }
Rotate {{0, 0, 1}, {0, 0, 0}, Pi/2} { Surface{3}; }
Extrude {9.424778, 0, 0} { Surface{3}; Layers{12}; }
