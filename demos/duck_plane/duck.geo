// Outline of a duck that looks to the right, in millimetres.
SetFactory("OpenCASCADE");
Point(1) = {-60, 40, 0};  // tip of the tail
Point(2) = {-52, 18, 0};
Point(3) = {-34, 3, 0};
Point(4) = {-8, -4, 0};
Point(5) = {20, -3, 0};
Point(6) = {42, 9, 0};
Point(7) = {49, 27, 0};   // breast
Point(8) = {45, 42, 0};
Point(9) = {50, 50, 0};
Point(10) = {69, 53, 0};  // tip of the beak
Point(11) = {53, 60, 0};
Point(12) = {49, 73, 0};
Point(13) = {35, 81, 0};  // top of the head
Point(14) = {19, 74, 0};
Point(15) = {14, 57, 0};
Point(16) = {6, 44, 0};
Point(17) = {-16, 38, 0}; // back
Point(18) = {-40, 36, 0};
Spline(1) = {1, 2, 3, 4, 5, 6, 7, 8, 9};
Spline(2) = {9, 10};
Spline(3) = {10, 11};
Spline(4) = {11, 12, 13, 14, 15, 16, 17, 18, 1};
Curve Loop(1) = {1, 2, 3, 4};
Plane Surface(1) = {1};
