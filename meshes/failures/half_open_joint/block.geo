// A block 1 x (0.5 + 0.5) with a joint across its middle, in two halves; 24 x 24 square cells.
cells = 12;  // along each half of the joint, and up each half of the block

For row In {0:2}
  For column In {0:2}
    Point(10*row + column + 1) = {0.5*column, 0.5*row, 0};
  EndFor
EndFor
For row In {0:2}
  Line(100 + 10*row) = {10*row + 1, 10*row + 2};
  Line(101 + 10*row) = {10*row + 2, 10*row + 3};
EndFor
For row In {0:1}
  For column In {0:2}
    Line(200 + 10*row + column) = {10*row + column + 1, 10*row + column + 11};
  EndFor
  For column In {0:1}
    Curve Loop(10*row + column + 1) = {
      100 + 10*row + column, 201 + 10*row + column, -(110 + 10*row + column), -(200 + 10*row + column)
    };
    Plane Surface(10*row + column + 1) = {10*row + column + 1};
  EndFor
EndFor
Transfinite Curve {100, 101, 110, 111, 120, 121, 200:202, 210:212} = cells + 1;
Transfinite Surface "*";
Recombine Surface "*";

Physical Surface("rock") = {1, 2, 11, 12};
Physical Curve("open") = {110};
Physical Curve("closed") = {111};
Physical Curve("south") = {100, 101};
Physical Curve("north") = {120, 121};
