// A box of 7.5 m x 25 m, quads of 25 cm: 20 to the length of the pulse.
Point(1) = {0, 0, 0};
Point(2) = {7.5, 0, 0};
Point(3) = {7.5, 25, 0};
Point(4) = {0, 25, 0};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4};
Plane Surface(1) = {1};
Transfinite Curve {1, 3} = 31;
Transfinite Curve {2, 4} = 101;
Transfinite Surface {1};
Recombine Surface {1};

Physical Surface("rock") = {1};
Physical Curve("south") = {1};
Physical Curve("east") = {2};
Physical Curve("north") = {3};
Physical Curve("west") = {4};
