// Every way fractures meet: A reaches the boundary and ends in the rock, B crosses it, C ends on B, D is an arc of its own.
h = 14;
Point(1) = {0, 0, 0, 2*h}; Point(2) = {200, 0, 0, 2*h}; Point(3) = {200, 200, 0, 2*h}; Point(4) = {0, 200, 0, 2*h};
Point(5) = {0, 100, 0, h}; Point(6) = {75, 100, 0, h}; Point(7) = {150, 100, 0, h};
Point(8) = {75, 40, 0, h}; Point(9) = {75, 60, 0, h}; Point(10) = {75, 160, 0, h};
Point(11) = {130, 60, 0, h};
Point(12) = {150, 150, 0, h}; Point(13) = {180, 150, 0, h}; Point(14) = {150, 180, 0, h};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 5}; Line(5) = {5, 1};
Line(11) = {5, 6}; Line(12) = {6, 7};
Line(21) = {8, 9}; Line(22) = {9, 6}; Line(23) = {6, 10};
Line(31) = {9, 11};
Circle(41) = {13, 12, 14};
Curve Loop(1) = {1, 2, 3, 4, 5};
Plane Surface(1) = {1};
Curve{11, 12, 21, 22, 23, 31, 41} In Surface{1};

Physical Surface("rock") = {1};
Physical Curve("south") = {1};
Physical Curve("east") = {2};
Physical Curve("north") = {3};
Physical Curve("west") = {4, 5};
Physical Curve("A") = {11, 12};
Physical Curve("B") = {21, 22, 23};
Physical Curve("C") = {31};
Physical Curve("D") = {41};
