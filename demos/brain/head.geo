// The upper half of a ball of brain, in millimetres; its plane z = 0 is one of symmetry.
SetFactory("OpenCASCADE");
Sphere(1) = {0, 0, 0, 80, 0, Pi/2, 2*Pi};
Physical Volume("brain") = {1};
