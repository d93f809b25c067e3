// A specimen of 1 m by 2 m with a joint at 60 degrees through its centre, out through both lateral faces.
W = 1;
H = 2;
slope = Sqrt(3);
size = 0.2;

Point(1) = {0, 0, 0, size};
Point(2) = {W, 0, 0, size};
Point(3) = {W, H/2 + slope*W/2, 0, size};
Point(4) = {W, H, 0, size};
Point(5) = {0, H, 0, size};
Point(6) = {0, H/2 - slope*W/2, 0, size};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 5};
Line(5) = {5, 6};
Line(6) = {6, 1};
Line(7) = {6, 3};
Curve Loop(1) = {1, 2, -7, 6};
Curve Loop(2) = {7, 3, 4, 5};
Plane Surface(1) = {1};
Plane Surface(2) = {2};

Physical Surface("rock") = {1, 2};
Physical Curve("joint") = {7};
Physical Curve("bottom") = {1};
Physical Curve("right") = {2, 3};
Physical Curve("top") = {4};
Physical Curve("left") = {5, 6};
Physical Point("pin") = {1};
